//! Transitions as columns: the form in which they travel, are journaled and are sampled.
//!
//! | column | shape | unit |
//! |---|---|---|
//! | observations, next_observations | `[n, observation_dim]` | scaled, [−1, 1] |
//! | actions | `[n, action_dim]` | scaled, [−1, 1] |
//! | rewards | `[n]` | – (eq 10, summed over the decision) |
//! | discounts | `[n]` | factor on the next value: 0 after a true ending, never 0 after a time limit |

use crate::spaces::Dims;

/// One decision, seen from outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition<'a> {
    /// What the policy saw, `[observation_dim]`.
    pub observation: &'a [f32],
    /// What it did, `[action_dim]`.
    pub action: &'a [f32],
    /// What that earned.
    pub reward: f32,
    /// Factor on the value of `next_observation`.
    pub discount: f32,
    /// What it saw next, `[observation_dim]`.
    pub next_observation: &'a [f32],
}

/// Transitions as columns.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Batch {
    /// Length of one observation.
    pub observation_dim: usize,
    /// Length of one action.
    pub action_dim: usize,
    /// `[n, observation_dim]`
    pub observations: Vec<f32>,
    /// `[n, action_dim]`
    pub actions: Vec<f32>,
    /// `[n]`
    pub rewards: Vec<f32>,
    /// `[n]`
    pub discounts: Vec<f32>,
    /// `[n, observation_dim]`
    pub next_observations: Vec<f32>,
}

/// Why a batch of transitions is refused.
#[derive(Clone, Debug, thiserror::Error, PartialEq)]
pub enum Error {
    /// A column has the wrong length.
    #[error("{column} has {found} numbers, expected {expected} for {count} transitions")]
    Length {
        /// Column name.
        column: &'static str,
        /// Transitions in the batch, by its rewards.
        count: usize,
        /// Numbers found.
        found: usize,
        /// Numbers that belong there.
        expected: usize,
    },
    /// A number is NaN, infinite or outside its range.
    #[error("{column}[{index}] of transition {transition} is {value}, expected {expected}")]
    Value {
        /// Column name.
        column: &'static str,
        /// Transition within the batch.
        transition: usize,
        /// Position within the transition.
        index: usize,
        /// The offending number.
        value: f32,
        /// The range that holds.
        expected: &'static str,
    },
}

impl Batch {
    /// An empty batch for spaces of these lengths.
    pub fn new(dims: Dims) -> Self {
        Self { observation_dim: dims.observation, action_dim: dims.action, ..Self::default() }
    }

    /// Lengths of an observation and an action.
    pub fn dims(&self) -> Dims {
        Dims { observation: self.observation_dim, action: self.action_dim }
    }

    /// Transitions held.
    pub fn len(&self) -> usize {
        self.rewards.len()
    }

    /// True when it holds none.
    pub fn is_empty(&self) -> bool {
        self.rewards.is_empty()
    }

    /// Appends one transition; lengths are the caller's promise and asserted.
    pub fn push(&mut self, transition: Transition<'_>) {
        assert_eq!(transition.observation.len(), self.observation_dim);
        assert_eq!(transition.action.len(), self.action_dim);
        assert_eq!(transition.next_observation.len(), self.observation_dim);
        self.observations.extend_from_slice(transition.observation);
        self.actions.extend_from_slice(transition.action);
        self.rewards.push(transition.reward);
        self.discounts.push(transition.discount);
        self.next_observations.extend_from_slice(transition.next_observation);
    }

    /// Appends all of `other`, whose spaces must have the same lengths.
    pub fn append(&mut self, other: &Self) {
        assert_eq!(self.dims(), other.dims());
        self.observations.extend_from_slice(&other.observations);
        self.actions.extend_from_slice(&other.actions);
        self.rewards.extend_from_slice(&other.rewards);
        self.discounts.extend_from_slice(&other.discounts);
        self.next_observations.extend_from_slice(&other.next_observations);
    }

    /// Transition `i`.
    pub fn get(&self, i: usize) -> Transition<'_> {
        let observation = i * self.observation_dim..(i + 1) * self.observation_dim;
        Transition {
            observation: &self.observations[observation.clone()],
            action: &self.actions[i * self.action_dim..(i + 1) * self.action_dim],
            reward: self.rewards[i],
            discount: self.discounts[i],
            next_observation: &self.next_observations[observation],
        }
    }

    /// Checks shapes and values; nothing unchecked may enter journal or replay.
    pub fn validate(&self) -> Result<(), Error> {
        let n = self.len();
        check_column("observation", &self.observations, n, self.observation_dim, UNIT)?;
        check_column("action", &self.actions, n, self.action_dim, UNIT)?;
        check_column("reward", &self.rewards, n, 1, FINITE)?;
        check_column("discount", &self.discounts, n, 1, FRACTION)?;
        check_column("next_observation", &self.next_observations, n, self.observation_dim, UNIT)
    }
}

type Range = (f32, f32, &'static str);
const UNIT: Range = (-1.0, 1.0, "a number in [-1, 1]");
const FRACTION: Range = (0.0, 1.0, "a number in [0, 1]");
const FINITE: Range = (-1e6, 1e6, "a finite number within ±1e6");

fn check_column(column: &'static str, numbers: &[f32], count: usize, width: usize, range: Range) -> Result<(), Error> {
    let (lowest, highest, expected) = range;
    if numbers.len() != count * width {
        return Err(Error::Length { column, count, found: numbers.len(), expected: count * width });
    }
    // `contains` is false for NaN, so one comparison covers every bad number. To count is vectorised, to search is not.
    let fits = |x: &f32| (lowest..=highest).contains(x);
    if numbers.iter().filter(|x| !fits(x)).count() == 0 {
        return Ok(());
    }
    match numbers.iter().position(|x| !fits(x)) {
        None => Ok(()),
        Some(at) => {
            Err(Error::Value { column, transition: at / width, index: at % width, value: numbers[at], expected })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spaces::{OBSERVATION_DIM, Task};

    fn batch(n: usize) -> Batch {
        let mut batch = Batch::new(Task::Gait.dims());
        for i in 0..n {
            let value = i as f32 / 100.0;
            batch.push(Transition {
                observation: &[value; OBSERVATION_DIM],
                action: &[-value; 4],
                reward: value,
                discount: 0.95,
                next_observation: &[value / 2.0; OBSERVATION_DIM],
            });
        }
        batch
    }

    #[test]
    fn what_is_pushed_comes_back() {
        let mut all = batch(2);
        all.append(&batch(3));
        assert_eq!(all.len(), 5);
        assert_eq!(all.get(4), batch(3).get(2));
        assert_eq!(all.validate(), Ok(()));
    }

    #[test]
    fn bad_numbers_are_named() {
        for bad in [f32::NAN, f32::INFINITY, 1.5] {
            let mut all = batch(3);
            all.next_observations[OBSERVATION_DIM + 7] = bad;
            let error = all.validate().expect_err("refused");
            assert!(
                matches!(error, Error::Value { column: "next_observation", transition: 1, index: 7, .. }),
                "{error}"
            );
        }
        let mut all = batch(3);
        all.discounts[2] = -0.1;
        assert!(all.validate().expect_err("refused").to_string().starts_with("discount[0] of transition 2 is -0.1"));
    }

    #[test]
    fn short_columns_are_named() {
        let mut all = batch(3);
        all.actions.pop();
        assert_eq!(all.validate(), Err(Error::Length { column: "action", count: 3, found: 11, expected: 12 }));
    }
}
