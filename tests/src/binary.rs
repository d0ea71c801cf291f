//! Where the `herd` binary under test lies.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// The binary that `cargo test --workspace` built beside this test; built here when it is not there.
pub fn herd() -> &'static Path {
    static FOUND: OnceLock<PathBuf> = OnceLock::new();
    FOUND.get_or_init(|| {
        let path = profile_dir().join("herd");
        if !path.exists() {
            build(&path);
        }
        path
    })
}

/// `target/<profile>`, from `target/<profile>/deps/<this test>`.
fn profile_dir() -> PathBuf {
    let test = std::env::current_exe().expect("a running test has a path");
    test.ancestors().nth(2).expect("tests lie in target/<profile>/deps").to_owned()
}

fn build(path: &Path) {
    let directory = path.parent().expect("a file lies in a directory");
    let profile = match directory.file_name().and_then(|name| name.to_str()) {
        Some("debug") | None => "dev",
        Some(other) => other,
    };
    eprintln!(
        "{} is missing: building it with profile {profile} (cargo test --workspace does so by itself)",
        path.display()
    );
    let target = directory.parent().expect("a profile lies in the target directory");
    let status = Command::new(env!("CARGO"))
        .args(["build", "--locked", "--package", "herd", "--profile", profile, "--target-dir"])
        .arg(target)
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .status()
        .expect("cargo starts");
    assert!(status.success() && path.exists(), "cargo build -p herd: {status}");
}
