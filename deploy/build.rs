//! Tells the binary which commit it is built from: `HERD_COMMIT`, a short hash, with `+dirty` if what goes into the
//! binary differs from it; `unknown` where the sources are no part of a git repository.
//!
//! It runs again when HEAD moves or a source changes, and then only: looking at the index would make every
//! `git status` a reason to link anew.

use std::path::Path;
use std::process::Command;

/// What goes into the binary, seen from here.
const SOURCES: [&str; 12] = [
    "src",
    "config",
    "build.rs",
    "Cargo.toml",
    "../common",
    "../proto",
    "../actor/src",
    "../actor/Cargo.toml",
    "../learner/src",
    "../learner/Cargo.toml",
    "../Cargo.toml",
    "../Cargo.lock",
];

fn main() {
    println!("cargo::rustc-env=HERD_COMMIT={}", commit().unwrap_or_else(|| "unknown".to_owned()));
    // Cargo takes a file that is not there for one that has changed.
    for path in SOURCES.iter().map(|path| (*path).to_owned()).chain(heads()).filter(|path| Path::new(path).exists()) {
        println!("cargo::rerun-if-changed={path}");
    }
}

fn commit() -> Option<String> {
    // A copy of the sources may lie within another repository, whose commit says nothing of them.
    git(&["ls-files", "--error-unmatch", "build.rs"])?;
    let hash = git(&["rev-parse", "--short=10", "HEAD"])?;
    let changes = git(&[&["status", "--porcelain", "--"], SOURCES.as_slice()].concat())?;
    Some(if changes.is_empty() { hash } else { hash + "+dirty" })
}

/// The files that change when HEAD moves; git knows where they are, in a worktree too.
fn heads() -> impl Iterator<Item = String> {
    let branch = git(&["symbolic-ref", "--quiet", "HEAD"]);
    let names = ["HEAD".to_owned(), "logs/HEAD".to_owned(), "packed-refs".to_owned()].into_iter().chain(branch);
    names.filter_map(|name| git(&["rev-parse", "--git-path", &name]))
}

/// What git says, if it is there and content.
fn git(words: &[&str]) -> Option<String> {
    let output = Command::new("git").arg("--no-optional-locks").args(words).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
