//! Files that appear whole or not at all, and directories that remember them after a power cut.

use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

/// Creates a directory with its parents and puts its name on disk.
pub(super) fn create_dir(dir: &Path) -> io::Result<()> {
    std::fs::create_dir_all(dir)?;
    dir.parent().map_or(Ok(()), sync_dir)
}

/// Writes a file aside, puts it on disk and moves it into place, over whatever had that name. Returns it open for
/// writing at its end.
pub(super) fn replace(path: &Path, bytes: &[u8]) -> io::Result<File> {
    let aside = path.with_extension({
        let mut extension = path.extension().map_or_else(OsString::new, ToOwned::to_owned);
        extension.push(".new");
        extension
    });
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

/// Puts the names in a directory on disk.
pub(super) fn sync_dir(dir: &Path) -> io::Result<()> {
    let dir = if dir.as_os_str().is_empty() { Path::new(".") } else { dir };
    File::open(dir)?.sync_all()
}
