//! The replay memory: the newest `capacity` transitions, one row each, sampled uniformly.
//!
//! | part of a row | numbers |
//! |---|---|
//! | observation, next observation | `observation_dim` each |
//! | action | `action_dim` |
//! | reward, discount | 1 each |
//!
//! Rows stand in blocks that are allocated as the memory fills, so that growing copies nothing and a sample touches one
//! place. A draw picks a transition by its age, never by its slot: a memory refilled from the journal's newest
//! `capacity` transitions gives the same batches as one that has lived since the start.

use herd_common::transition;
use rand::{Rng, RngExt};
use std::sync::Arc;

/// Rows of one block; a power of two.
const BLOCK_ROWS: usize = 4096;

/// Tells one memory from every other, for those that keep a copy.
#[derive(Clone, Debug)]
pub struct Identity(Arc<()>);

impl PartialEq for Identity {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// The newest transitions, first in, first out.
#[derive(Debug)]
pub struct Replay {
    identity: Identity,
    capacity: usize,
    observation_dim: usize,
    action_dim: usize,
    /// Transitions ever pushed.
    pushed: u64,
    /// Transitions held.
    len: usize,
    /// Slot of the oldest one; not 0 only once the memory is full.
    oldest: usize,
    blocks: Vec<Box<[f32]>>,
}

/// One transition, where it stands in the memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row<'a> {
    /// `[observation_dim]`
    pub observation: &'a [f32],
    /// `[action_dim]`
    pub action: &'a [f32],
    /// As it was pushed.
    pub reward: f32,
    /// 0 after a true ending.
    pub discount: f32,
    /// `[observation_dim]`
    pub next_observation: &'a [f32],
}

impl Replay {
    /// An empty memory for `capacity` transitions of these lengths.
    pub fn new(capacity: usize, observation_dim: usize, action_dim: usize) -> Self {
        assert!(capacity > 0, "a replay memory holds at least one transition");
        let identity = Identity(Arc::new(()));
        Self { identity, capacity, observation_dim, action_dim, pushed: 0, len: 0, oldest: 0, blocks: Vec::new() }
    }

    /// Transitions held.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Transitions ever pushed, those that were replaced included.
    pub fn pushed(&self) -> u64 {
        self.pushed
    }

    /// True until the first push.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Transitions that can be held.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Length of one observation.
    pub fn observation_dim(&self) -> usize {
        self.observation_dim
    }

    /// Length of one action.
    pub fn action_dim(&self) -> usize {
        self.action_dim
    }

    /// Adds every transition of `batch` in order; each beyond the capacity replaces the oldest.
    ///
    /// The batch has been validated; columns of wrong lengths are a mistake of the program.
    pub fn push(&mut self, batch: &transition::Batch) {
        let (n, observation, action) = (batch.rewards.len(), self.observation_dim, self.action_dim);
        self.pushed += n as u64;
        assert_eq!(batch.observations.len(), n * observation, "observations of {n} transitions");
        assert_eq!(batch.next_observations.len(), n * observation, "next observations of {n} transitions");
        assert_eq!(batch.actions.len(), n * action, "actions of {n} transitions");
        assert_eq!(batch.discounts.len(), n, "discounts of {n} transitions");
        for i in 0..n {
            let row = self.next_row();
            let (seen, row) = row.split_at_mut(observation);
            let (next, row) = row.split_at_mut(observation);
            let (done, row) = row.split_at_mut(action);
            seen.copy_from_slice(&batch.observations[i * observation..][..observation]);
            next.copy_from_slice(&batch.next_observations[i * observation..][..observation]);
            done.copy_from_slice(&batch.actions[i * action..][..action]);
            row.copy_from_slice(&[batch.rewards[i], batch.discounts[i]]);
        }
    }

    /// Draws `n` transitions uniformly, with replacement; none if the memory is empty. Nothing is copied.
    pub fn draw<'a>(&'a self, n: usize, rng: &mut impl Rng) -> impl ExactSizeIterator<Item = Row<'a>> {
        self.draw_ranks(n, rng).map(|age_rank| self.row(age_rank))
    }

    /// As `draw`, but says of each transition how many are older.
    pub fn draw_ranks(&self, n: usize, rng: &mut impl Rng) -> impl ExactSizeIterator<Item = usize> {
        let (len, n) = (self.len as u64, if self.is_empty() { 0 } else { n });
        (0..n).map(move |_| rng.random_range(0..len) as usize)
    }

    /// The transition that `age_rank` others are older than.
    pub fn row(&self, age_rank: usize) -> Row<'_> {
        let slot = self.slot(age_rank);
        let width = self.row_width();
        let row = &self.blocks[slot / BLOCK_ROWS][slot % BLOCK_ROWS * width..][..width];
        let (observation, row) = row.split_at(self.observation_dim);
        let (next_observation, row) = row.split_at(self.observation_dim);
        let (action, row) = row.split_at(self.action_dim);
        Row { observation, action, reward: row[0], discount: row[1], next_observation }
    }

    /// Where that transition stands; its slot stays until it is replaced.
    pub fn slot(&self, age_rank: usize) -> usize {
        (self.oldest + age_rank) % self.capacity
    }

    /// Which memory this is.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// The transitions that were pushed after the first `pushed` ones and are held, if there are any:
    /// the slot of a first one, then its row and those that follow in memory, observation, next observation, action,
    /// reward and discount each.
    pub fn since(&self, pushed: u64) -> impl Iterator<Item = (usize, &[f32])> {
        let (width, capacity) = (self.row_width(), self.capacity);
        let mut number = pushed.max(self.pushed - self.len as u64);
        std::iter::from_fn(move || {
            let missing = usize::try_from(self.pushed.saturating_sub(number)).expect("no more than are held");
            let slot = (number % capacity as u64) as usize;
            let row = slot % BLOCK_ROWS;
            let together = missing.min(BLOCK_ROWS - row).min(capacity - slot);
            number += together as u64;
            (together > 0).then(|| (slot, &self.blocks[slot / BLOCK_ROWS][row * width..][..together * width]))
        })
    }

    /// Numbers of one row.
    pub fn row_width(&self) -> usize {
        Self::width(self.observation_dim, self.action_dim)
    }

    /// Numbers of one row of a memory for these lengths.
    pub fn width(observation_dim: usize, action_dim: usize) -> usize {
        2 * observation_dim + action_dim + 2
    }

    /// Makes room for one more transition, at the cost of the oldest if need be.
    fn next_row(&mut self) -> &mut [f32] {
        let slot = if self.len < self.capacity {
            self.len += 1;
            self.len - 1
        } else {
            let slot = self.oldest;
            self.oldest = (slot + 1) % self.capacity;
            slot
        };
        let width = self.row_width();
        if slot / BLOCK_ROWS == self.blocks.len() {
            let rows = BLOCK_ROWS.min(self.capacity - slot);
            self.blocks.push(vec![0.0; rows * width].into_boxed_slice());
        }
        &mut self.blocks[slot / BLOCK_ROWS][slot % BLOCK_ROWS * width..][..width]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::seed::Seed;
    use proptest::prelude::*;

    /// Transitions numbered from `first`; every number of transition i tells i, so that a mixed-up row shows.
    fn numbered(first: usize, n: usize) -> transition::Batch {
        let ids: Vec<f32> = (first..first + n).map(|i| i as f32).collect();
        let column = |width: usize, offset: f32| ids.iter().flat_map(|i| vec![i + offset; width]).collect();
        transition::Batch {
            observation_dim: 3,
            action_dim: 2,
            observations: column(3, 0.0),
            actions: column(2, 0.125),
            rewards: column(1, 0.25),
            discounts: column(1, 0.5),
            next_observations: column(3, 0.75),
        }
    }

    fn draw(replay: &Replay, n: usize, seed: u64) -> Vec<Row<'_>> {
        replay.draw(n, &mut Seed::from_number(seed).rng()).collect()
    }

    proptest! {
        #[test]
        fn only_the_newest_are_drawn_and_rows_stay_whole(
            capacity in 1_usize..10_000,
            pushes in prop::collection::vec(0_usize..5_000, 0..5),
            seed in any::<u64>(),
        ) {
            let mut replay = Replay::new(capacity, 3, 2);
            let mut pushed = 0;
            for n in pushes {
                replay.push(&numbered(pushed, n));
                pushed += n;
            }
            prop_assert_eq!(replay.len(), pushed.min(capacity));
            let rows = draw(&replay, 50, seed);
            prop_assert_eq!(rows.len(), if pushed == 0 { 0 } else { 50 });
            for row in rows {
                let id = row.observation[0] as usize;
                prop_assert!((pushed - replay.len()..pushed).contains(&id), "{} of {}", id, pushed);
                let expected = numbered(id, 1);
                prop_assert_eq!(row.observation, &expected.observations[..]);
                prop_assert_eq!(row.action, &expected.actions[..]);
                prop_assert_eq!(row.reward, expected.rewards[0]);
                prop_assert_eq!(row.discount, expected.discounts[0]);
                prop_assert_eq!(row.next_observation, &expected.next_observations[..]);
            }
        }

        #[test]
        fn a_copy_that_is_told_what_is_new_is_the_memory(
            capacity in 1_usize..10_000,
            pushes in prop::collection::vec(0_usize..5_000, 1..6),
        ) {
            let mut replay = Replay::new(capacity, 3, 2);
            let mut copy = vec![f32::NAN; capacity * replay.row_width()];
            let (mut known, mut copied) = (0, 0);
            for n in pushes {
                replay.push(&numbered(replay.pushed() as usize, n));
                for (slot, numbers) in replay.since(known) {
                    copy[slot * replay.row_width()..][..numbers.len()].copy_from_slice(numbers);
                    copied += numbers.len() / replay.row_width();
                }
                known = replay.pushed();
                prop_assert!(copied as u64 <= known, "{} copied of {}", copied, known);
                prop_assert_eq!(replay.since(known + n as u64).count(), 0, "nothing is newer than the newest");
            }
            for age_rank in 0..replay.len() {
                let (row, found) = (replay.row(age_rank), &copy[replay.slot(age_rank) * replay.row_width()..]);
                let expected =
                    [row.observation, row.next_observation, row.action, &[row.reward, row.discount]].concat();
                prop_assert_eq!(&found[..expected.len()], &expected[..]);
            }
        }

        #[test]
        fn draws_depend_on_what_is_held_not_on_what_came_before(before in 0_usize..9_000, seed in any::<u64>()) {
            let (mut old, mut young) = (Replay::new(5_000, 3, 2), Replay::new(5_000, 3, 2));
            old.push(&numbered(0, before));
            old.push(&numbered(before, 5_000));
            young.push(&numbered(before, 5_000));
            prop_assert_eq!(draw(&old, 64, seed), draw(&young, 64, seed));
        }
    }

    #[test]
    fn every_transition_is_as_likely() {
        let mut replay = Replay::new(50, 3, 2);
        replay.push(&numbered(0, 120));
        let mut counts = [0_u32; 50];
        for row in draw(&replay, 100_000, 1) {
            counts[row.observation[0] as usize - 70] += 1;
        }
        // χ² with 49 degrees of freedom exceeds 94 once in 10 000 fair draws.
        let chi2: f64 = counts.iter().map(|n| (f64::from(*n) - 2000.0).powi(2) / 2000.0).sum();
        assert!(chi2 < 94.0, "{chi2} from {counts:?}");
    }
}
