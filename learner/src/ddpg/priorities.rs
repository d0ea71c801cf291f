//! Prioritised replay (Schaul et al. 2016, proportional): transitions that surprised are drawn more often.
//!
//! | symbol | name |
//! |---|---|
//! | δ | surprise: the first critic's error at the last draw; what was never drawn has the largest δ so far |
//! | p = (\|δ\| + ε)^α | priority; α = 0 would be uniform |
//! | w = (N p / Σp)^−β, over its maximum in the batch | weight of the loss, which takes back what priority bends |
//!
//! Priorities are kept as whole numbers. Their sums are exact in any order, so a draw depends on what is held and on
//! nothing else: a memory refilled after a crash gives the same minibatches. Sums stand in a binary tree over slots,
//! `slot = transition number mod capacity`.

use super::error::Error;
use super::snapshot::{Record, check_finite};
use rand::{Rng, RngExt};

/// ε, in units of scaled reward.
const LEAST_SURPRISE: f32 = 1e-3;
/// The whole number that stands for p = 1.
const UNIT: f64 = (1_u64 << 20) as f64;
/// Largest priority: sums over the 10⁸ transitions that a memory may hold stay below 2⁶³.
const LARGEST: f64 = (1_u64 << 36) as f64;

/// Surprises of the transitions that a replay memory holds.
#[derive(Clone, Debug)]
pub(super) struct Priorities {
    alpha: f64,
    beta: f64,
    capacity: usize,
    /// Transitions pushed so far, those no longer held included.
    seen: u64,
    largest: f32,
    /// |δ| by slot.
    surprises: Vec<f32>,
    /// `tree[1]` is the sum of all, `tree[leaves + slot]` the priority of a slot; `leaves` is a power of two.
    tree: Vec<u64>,
}

/// One draw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Draw {
    /// Transitions held that are older.
    pub(super) age_rank: usize,
    /// Of the loss.
    pub(super) weight: f32,
}

impl Priorities {
    /// For a memory of this capacity.
    pub(super) fn new(alpha: f64, beta: f64, capacity: usize) -> Self {
        Self { alpha, beta, capacity, seen: 0, largest: 1.0, surprises: Vec::new(), tree: vec![0; 2] }
    }

    /// Transitions seen so far.
    pub(super) fn seen(&self) -> u64 {
        self.seen
    }

    /// Takes in what was pushed since the last call, `pushed` being all there ever was: each gets the largest surprise.
    pub(super) fn grow(&mut self, pushed: u64) {
        for number in self.seen..pushed {
            let slot = (number % self.capacity as u64) as usize;
            if slot == self.surprises.len() {
                self.surprises.push(0.0);
                self.make_room();
            }
            self.set(slot, self.largest);
        }
        self.seen = self.seen.max(pushed);
    }

    /// Draws `n` transitions, with replacement.
    pub(super) fn draw(&self, n: usize, rng: &mut impl Rng) -> Vec<Draw> {
        let total = self.tree[1];
        let older = self.sum_before(self.oldest());
        let mut draws: Vec<Draw> = (0..n)
            .map(|_| {
                // Counted from the oldest on, so that the slots at which the memory happens to stand do not show.
                let slot = self.find((older + rng.random_range(0..total)) % total);
                let share = self.tree[self.leaves() + slot] as f64 / total as f64;
                let weight = (self.surprises.len() as f64 * share).powf(-self.beta) as f32;
                Draw { age_rank: self.age_rank(slot), weight }
            })
            .collect();
        let largest = draws.iter().fold(0.0_f32, |largest, draw| largest.max(draw.weight));
        for draw in &mut draws {
            draw.weight /= largest;
        }
        draws
    }

    /// Notes how much each drawn transition surprised.
    pub(super) fn note(&mut self, draws: &[Draw], errors: &[f32]) {
        for (draw, error) in draws.iter().zip(errors) {
            let slot = (self.oldest() + draw.age_rank) % self.capacity;
            self.largest = self.largest.max(error.abs());
            self.set(slot, error.abs());
        }
    }

    /// What lasts, oldest transition first.
    pub(super) fn save(&self) -> [Record; 2] {
        let n = self.surprises.len();
        let values = (0..n).map(|rank| self.surprises[(self.oldest() + rank) % self.capacity]).collect();
        let record = |name: &str, values: Vec<f32>| Record { name: name.into(), shape: vec![values.len()], values };
        [record(SURPRISES, values), record(LARGEST_SURPRISE, vec![self.largest])]
    }

    /// These priorities as they were after `seen` transitions.
    pub(super) fn load(&self, seen: u64, surprises: &Record, largest: &Record) -> Result<Self, Error> {
        let held = seen.min(self.capacity as u64) as usize;
        for (record, name, len) in [(surprises, SURPRISES, held), (largest, LARGEST_SURPRISE, 1)] {
            if record.name != name || record.values.len() != len {
                let found = format!("tensor {} with {} numbers", record.name, record.values.len());
                return Err(Error::Snapshot { found, expected: format!("tensor {name} with {len} numbers") });
            }
            check_finite(name, &record.values)?;
        }
        let mut loaded = Self::new(self.alpha, self.beta, self.capacity);
        loaded.grow(seen);
        loaded.largest = largest.values[0];
        for (rank, surprise) in surprises.values.iter().enumerate() {
            loaded.set((loaded.oldest() + rank) % loaded.capacity, *surprise);
        }
        Ok(loaded)
    }

    /// Slot of the oldest transition held.
    fn oldest(&self) -> usize {
        let wrapped = self.seen > self.capacity as u64;
        if wrapped { (self.seen % self.capacity as u64) as usize } else { 0 }
    }

    fn age_rank(&self, slot: usize) -> usize {
        (slot + self.capacity - self.oldest()) % self.capacity
    }

    fn leaves(&self) -> usize {
        self.tree.len() / 2
    }

    /// Doubles the tree when a slot has no leaf.
    fn make_room(&mut self) {
        let leaves = self.surprises.len().next_power_of_two();
        if leaves == self.leaves() {
            return;
        }
        let mut tree = vec![0; 2 * leaves];
        tree[leaves..leaves + self.leaves()].copy_from_slice(&self.tree[self.leaves()..]);
        for node in (1..leaves).rev() {
            tree[node] = tree[2 * node] + tree[2 * node + 1];
        }
        self.tree = tree;
    }

    fn set(&mut self, slot: usize, surprise: f32) {
        self.surprises[slot] = surprise;
        let priority = f64::from(surprise + LEAST_SURPRISE).powf(self.alpha) * UNIT;
        let mut node = self.leaves() + slot;
        self.tree[node] = priority.clamp(1.0, LARGEST) as u64;
        while node > 1 {
            node /= 2;
            self.tree[node] = self.tree[2 * node] + self.tree[2 * node + 1];
        }
    }

    /// Sum over the slots before this one.
    fn sum_before(&self, slot: usize) -> u64 {
        let (mut node, mut sum) = (self.leaves() + slot, 0);
        while node > 1 {
            if node % 2 == 1 {
                sum += self.tree[node - 1];
            }
            node /= 2;
        }
        sum
    }

    /// The slot within whose share `at`, below the sum of all, lies.
    fn find(&self, mut at: u64) -> usize {
        let mut node = 1;
        while node < self.leaves() {
            node *= 2;
            if at >= self.tree[node] {
                at -= self.tree[node];
                node += 1;
            }
        }
        node - self.leaves()
    }
}

const SURPRISES: &str = "priorities.surprises";
const LARGEST_SURPRISE: &str = "priorities.largest";

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::seed::Seed;
    use proptest::prelude::*;

    fn drawn(priorities: &Priorities, n: usize, seed: u64) -> Vec<Draw> {
        priorities.draw(n, &mut Seed::from_number(seed).rng())
    }

    /// Memories of this capacity, with `pushed` transitions of which some were noted.
    fn lived(capacity: usize, pushed: u64, alpha: f64) -> Priorities {
        let mut priorities = Priorities::new(alpha, 0.5, capacity);
        for until in [pushed / 3, pushed / 2, pushed] {
            priorities.grow(until);
            if until > 0 {
                let draws = drawn(&priorities, 20, until);
                let errors: Vec<f32> = (0_u8..20).map(|i| f32::from(i) - 7.0).collect();
                priorities.note(&draws, &errors);
            }
        }
        priorities
    }

    proptest! {
        #[test]
        fn what_is_loaded_draws_the_same(capacity in 1_usize..300, pushed in 1_u64..1000, alpha in 0.0..1.0) {
            let old = lived(capacity, pushed, alpha);
            let [surprises, largest] = old.save();
            let young = Priorities::new(alpha, 0.5, capacity).load(old.seen(), &surprises, &largest).unwrap();
            prop_assert_eq!(drawn(&old, 50, 9), drawn(&young, 50, 9));
            let held = (pushed as usize).min(capacity);
            prop_assert!(drawn(&old, 50, 10).iter().all(|draw| draw.age_rank < held));
        }

        #[test]
        fn sums_are_those_of_the_leaves(capacity in 1_usize..300, pushed in 1_u64..1000) {
            let priorities = lived(capacity, pushed, 0.6);
            let leaves = &priorities.tree[priorities.leaves()..];
            prop_assert_eq!(priorities.tree[1], leaves.iter().sum::<u64>());
            for slot in 0..priorities.surprises.len() {
                let before: u64 = leaves[..slot].iter().sum();
                prop_assert_eq!(priorities.sum_before(slot), before);
                prop_assert_eq!(priorities.find(before), slot);
                prop_assert_eq!(priorities.find(before + leaves[slot] - 1), slot);
            }
        }
    }

    #[test]
    fn draws_follow_the_priorities_and_weights_take_them_back() {
        let mut priorities = Priorities::new(0.5, 1.0, 4);
        priorities.grow(4);
        let draws: Vec<Draw> = (0..4).map(|age_rank| Draw { age_rank, weight: 1.0 }).collect();
        let errors = [0.0, 1.0, -4.0, 9.0];
        priorities.note(&draws, &errors);
        let drawn = drawn(&priorities, 100_000, 1);
        // p = √|δ|: 0.03, 1, 2, 3 of about 6.
        let shares: Vec<f64> =
            (0..4).map(|rank| drawn.iter().filter(|draw| draw.age_rank == rank).count() as f64 / 1e5).collect();
        for (rank, expected) in [0.0052, 0.1658, 0.3315, 0.4973].into_iter().enumerate() {
            assert!((shares[rank] - expected).abs() < 0.005, "{shares:?}");
        }
        // With β = 1 weight × share is the same for all.
        let weight = |rank: usize| f64::from(drawn.iter().find(|draw| draw.age_rank == rank).unwrap().weight);
        assert!((weight(1) / weight(2) - 2.0).abs() < 0.01 && (weight(0) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn what_is_new_is_as_urgent_as_the_greatest_surprise() {
        let mut priorities = Priorities::new(1.0, 0.0, 8);
        priorities.grow(2);
        priorities.note(&[Draw { age_rank: 0, weight: 1.0 }, Draw { age_rank: 1, weight: 1.0 }], &[0.0, 50.0]);
        priorities.grow(3);
        assert_eq!(priorities.surprises, [0.0, 50.0, 50.0]);
    }

    #[test]
    fn foreign_snapshots_are_refused() {
        let old = lived(10, 7, 0.6);
        let [surprises, largest] = old.save();
        let error = old.load(9, &surprises, &largest).unwrap_err().to_string();
        assert!(error.contains("priorities.surprises with 7 numbers") && error.contains("9 numbers"), "{error}");
        assert!(old.load(7, &largest, &surprises).is_err());
    }
}
