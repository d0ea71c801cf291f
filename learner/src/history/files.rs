//! Files that appear whole or not at all, and directories that remember them after a power cut.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

/// Ends the name of a file that is not whole yet.
const ASIDE: &str = "new";

/// Creates a directory with its parents and puts its name on disk.
pub(super) fn create_dir(dir: &Path) -> io::Result<()> {
    std::fs::create_dir_all(dir)?;
    dir.parent().map_or(Ok(()), sync_dir)
}

/// Writes a file aside, puts it on disk and moves it into place, over whatever had that name. Returns it open for
/// writing at its end.
pub(super) fn replace(path: &Path, bytes: &[u8]) -> io::Result<File> {
    let aside = path.with_added_extension(ASIDE);
    let mut file = OpenOptions::new().write(true).create(true).truncate(true).open(&aside)?;
    let placed = file.write_all(bytes).and_then(|()| file.sync_all()).and_then(|()| std::fs::rename(&aside, path));
    if let Err(error) = placed {
        // What could not be finished only takes room, perhaps the room that is missing.
        let _ = std::fs::remove_file(&aside);
        return Err(error);
    }
    path.parent().map_or(Ok(()), sync_dir)?;
    Ok(file)
}

/// Removes what writers that died left aside in a directory.
pub(super) fn sweep(dir: &Path) -> io::Result<()> {
    for entry in std::fs::read_dir(dir)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == ASIDE) {
            std::fs::remove_file(path)?;
        }
    }
    Ok(())
}

/// Puts the names in a directory on disk.
pub(super) fn sync_dir(dir: &Path) -> io::Result<()> {
    let dir = if dir.as_os_str().is_empty() { Path::new(".") } else { dir };
    File::open(dir)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    #[test]
    fn a_file_is_replaced_whole_and_nothing_stays_aside() {
        let dir = tempfile::tempdir().expect("directory");
        let path = dir.path().join("a.ckpt");
        std::fs::write(dir.path().join("b.ckpt.new"), "half").expect("written");
        drop(replace(&path, b"old").expect("written"));
        replace(&path, b"new").expect("written").write_all(b"er").expect("goes on at the end");
        sweep(dir.path()).expect("swept");
        let mut text = String::new();
        File::open(&path).expect("there").read_to_string(&mut text).expect("text");
        assert_eq!(text, "newer");
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);
    }

    #[test]
    fn a_failed_replacement_leaves_the_old_file() {
        let dir = tempfile::tempdir().expect("directory");
        let path = dir.path().join("a");
        std::fs::create_dir_all(path.join("in the way")).expect("created");
        assert!(replace(&path, b"new").is_err());
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);
    }
}
