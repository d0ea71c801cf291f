//! Damage to files, as disks and power cuts do it.

use std::fs::{self, OpenOptions};
use std::path::{Path, PathBuf};

/// Cuts the last `bytes` off a file.
#[track_caller]
pub fn truncate(path: &Path, bytes: u64) {
    let file = OpenOptions::new().write(true).open(path).expect("the file is there");
    let length = file.metadata().expect("it has a length").len();
    assert!(length > bytes, "{} has {length} bytes only", path.display());
    file.set_len(length - bytes).expect("it can be cut");
}

/// Flips every bit of 16 bytes in the middle of a file.
#[track_caller]
pub fn garble_the_middle(path: &Path) {
    let mut bytes = fs::read(path).expect("the file is there");
    let middle = bytes.len() / 2;
    assert!(middle > 16, "{} is too small to have a middle", path.display());
    bytes[middle..middle + 16].iter_mut().for_each(|byte| *byte = !*byte);
    fs::write(path, bytes).expect("it can be written");
}

/// The last file of a directory by name: the newest segment of a journal, the newest checkpoint.
#[track_caller]
pub fn newest(directory: &Path) -> PathBuf {
    files(directory).pop().unwrap_or_else(|| panic!("{} is empty", directory.display()))
}

/// The files of a directory, by name.
#[track_caller]
pub fn files(directory: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(directory).unwrap_or_else(|error| panic!("{}: {error}", directory.display()));
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).filter(|path| path.is_file()).collect();
    paths.sort();
    paths
}
