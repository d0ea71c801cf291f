//! How many leases each actor holds, so that nobody has to search for them.

use std::collections::BTreeMap;

/// Leases by the actor that holds them.
#[derive(Debug, Default)]
pub(super) struct Holders {
    /// No entry for none.
    counts: BTreeMap<u64, usize>,
}

impl Holders {
    /// One lease more for an actor.
    pub(super) fn take(&mut self, actor: u64) {
        *self.counts.entry(actor).or_default() += 1;
    }

    /// One lease less for each actor, as often as it is named.
    pub(super) fn let_go(&mut self, actors: impl IntoIterator<Item = u64>) {
        for actor in actors {
            let Some(count) = self.counts.get_mut(&actor) else { continue };
            *count -= 1;
            if *count == 0 {
                self.counts.remove(&actor);
            }
        }
    }

    /// Leases that an actor holds.
    pub(super) fn of(&self, actor: u64) -> usize {
        self.counts.get(&actor).copied().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leases_are_counted_and_forgotten() {
        let mut holders = Holders::default();
        for actor in [7, 8, 7] {
            holders.take(actor);
        }
        assert_eq!((holders.of(7), holders.of(8), holders.of(9)), (2, 1, 0));
        holders.let_go([7, 9, 8]);
        assert_eq!((holders.of(7), holders.of(8)), (1, 0));
        holders.let_go([7]);
        assert!(holders.counts.is_empty());
    }
}
