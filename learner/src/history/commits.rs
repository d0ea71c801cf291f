//! Which episodes are committed: a prefix without holes and, in throughput order, some numbers beyond it.

use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// A set of episode numbers that is nearly `0..n`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Commits {
    prefix: u64,
    beyond: BTreeSet<u64>,
}

impl Commits {
    /// Adds an episode; false when it is there already.
    pub fn insert(&mut self, episode: u64) -> bool {
        if self.contains(episode) {
            return false;
        }
        self.beyond.insert(episode);
        while self.beyond.remove(&self.prefix) {
            self.prefix += 1;
        }
        true
    }

    /// True when this episode is committed.
    pub fn contains(&self, episode: u64) -> bool {
        episode < self.prefix || self.beyond.contains(&episode)
    }

    /// Episodes committed, which is also the version of the policy that has digested them all.
    pub fn count(&self) -> u64 {
        self.prefix + self.beyond.len() as u64
    }

    /// The lowest episode that is not committed.
    pub fn first_missing(&self) -> u64 {
        self.prefix
    }

    /// One more than the highest committed episode; 0 for an empty set.
    pub fn end(&self) -> u64 {
        self.beyond.last().map_or(self.prefix, |highest| highest + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_is_the_set_of_what_was_inserted(episodes in prop::collection::vec(0_u64..40, 0..60)) {
            let mut commits = Commits::default();
            let mut model = BTreeSet::new();
            for episode in episodes {
                prop_assert_eq!(commits.insert(episode), model.insert(episode));
            }
            prop_assert!((0..41).all(|e| commits.contains(e) == model.contains(&e)));
            prop_assert_eq!(commits.count(), model.len() as u64);
            prop_assert_eq!(commits.end(), model.last().map_or(0, |e| e + 1));
            prop_assert_eq!(Some(commits.first_missing()), (0..=40).find(|e| !model.contains(e)));
            prop_assert!(!commits.beyond.contains(&commits.prefix), "the prefix swallows what touches it");
        }
    }
}
