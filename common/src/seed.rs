//! The seed tree: every random number of a run descends from one root by named, numbered branches.
//!
//! `child(name, index)` is SHA-256 over (parent, name, index), so a branch is a pure function of its path: nothing
//! has to be saved to resume a stream, and adding a branch never shifts the numbers of another.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};

/// A node of the seed tree; 32 bytes, so that it is also a `ChaCha` key.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Seed([u8; 32]);

impl Seed {
    /// The root for the number a user gives with `--seed`.
    pub fn from_number(number: u64) -> Self {
        Self(Sha256::digest([b"herd seed".as_slice(), &number.to_le_bytes()].concat()).into())
    }

    /// The branch `name[index]` below this node.
    pub fn child(&self, name: &str, index: u64) -> Self {
        let mut hasher = Sha256::new();
        hasher.update(self.0);
        hasher.update((name.len() as u64).to_le_bytes());
        hasher.update(name.as_bytes());
        hasher.update(index.to_le_bytes());
        Self(hasher.finalize().into())
    }

    /// A generator that starts at this node.
    pub fn rng(&self) -> ChaCha8Rng {
        ChaCha8Rng::from_seed(self.0)
    }

    /// The node as bytes, for the wire.
    pub fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

impl From<[u8; 32]> for Seed {
    fn from(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng;

    #[test]
    fn a_branch_depends_on_every_part_of_its_path() {
        let root = Seed::from_number(1);
        let child = root.child("episode", 7);
        assert_eq!(child, Seed::from_number(1).child("episode", 7));
        for other in [
            root.child("episode", 8),
            root.child("episodes", 7),
            Seed::from_number(2).child("episode", 7),
            root.child("episode", 7).child("", 0),
        ] {
            assert_ne!(child, other);
        }
    }

    #[test]
    fn the_stream_is_pinned() {
        // A change of this number means that every run ever made gives other bits: a breaking change.
        assert_eq!(Seed::from_number(1).child("episode", 0).rng().next_u64(), PINNED);
    }

    const PINNED: u64 = 13_899_618_707_447_004_608;
}
