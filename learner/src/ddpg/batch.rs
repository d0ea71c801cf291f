//! A minibatch as matrices; those that networks read live as long as the learner.
//!
//! | matrix | what | shape |
//! |---|---|---|
//! | `inputs`, `inputs_by_row` | (s, a), and turned over | `[observation + action, n]`, `[n, observation + action]` |
//! | `observations_by_row` | s, turned over; not a part of `inputs_by_row`, whose strip goes on with a | `[n, observation]` |
//! | `own_inputs` | (s, π(s)) | `[observation + action, n]` |
//! | `next_inputs`, `next_by_row` | (s′, π′(s′)), and (s′, 0) turned over | `[observation + action, n]`, `[n, observation + action]` |
//! | `rewards`, `discounts` | r in units that are learned, γ | `[n, 1]` |
//! | `weights` | of each transition's loss; 1 unless replay is prioritised | `[n, 1]` |
//!
//! Actors read the same matrices as critics, without the last rows.

use super::error::Error;
use super::strips::{Strips, turn};
use crate::replay::Row;
use candle_core::{Device, Result, Tensor};
use herd_common::spaces::Dims;

/// The matrices of one minibatch.
#[derive(Debug)]
pub struct Batch {
    len: usize,
    dims: Dims,
    inputs: Strips,
    inputs_by_row: Strips,
    observations_by_row: Strips,
    own_inputs: Strips,
    next_inputs: Strips,
    /// (s′, 0), turned over.
    next_by_row: Strips,
    rewards: Tensor,
    discounts: Tensor,
    weights: Tensor,
}

impl Batch {
    /// Room for `len` transitions.
    pub fn new(len: usize, dims: Dims) -> std::result::Result<Self, Error> {
        let width = dims.observation + dims.action;
        let ones = column(vec![1.0; len])?;
        Ok(Self {
            len,
            dims,
            inputs: Strips::new(width, len),
            inputs_by_row: Strips::new(len, width),
            observations_by_row: Strips::new(len, dims.observation),
            own_inputs: Strips::new(width, len),
            next_inputs: Strips::new(width, len),
            next_by_row: Strips::new(len, width),
            rewards: ones.clone(),
            discounts: ones.clone(),
            weights: ones,
        })
    }

    /// Takes these transitions, of which there are as many as there is room for; rewards are multiplied by `reward_scale`.
    pub fn fill(&mut self, rows: &[Row<'_>], reward_scale: f32) -> std::result::Result<(), Error> {
        assert_eq!(rows.len(), self.len, "transitions of a minibatch");
        let observation = self.dims.observation;
        fetch(rows);
        for (i, row) in rows.iter().enumerate() {
            // Not by way of a row of its own: what is read right after it was written waits for the memory behind it.
            self.inputs_by_row.set_row(i, row.observation);
            self.inputs_by_row.set_part(i, observation, row.action);
            self.observations_by_row.set_row(i, row.observation);
            self.next_by_row.set_row(i, row.next_observation);
        }
        turn(&mut self.inputs, &self.inputs_by_row);
        turn(&mut self.next_inputs, &self.next_by_row);
        self.own_inputs.set_rows(0, &self.inputs, 0..observation);
        self.rewards = column(rows.iter().map(|row| reward_scale * row.reward).collect())?;
        self.discounts = column(rows.iter().map(|row| row.discount).collect())?;
        Ok(())
    }

    /// (s, a), `[observation + action, n]`; above all rows of s.
    pub(super) fn inputs(&self) -> &Strips {
        &self.inputs
    }

    /// (s, a), `[n, observation + action]`.
    pub(super) fn inputs_by_row(&self) -> &Strips {
        &self.inputs_by_row
    }

    /// s, `[n, observation]`.
    pub(super) fn observations_by_row(&self) -> &Strips {
        &self.observations_by_row
    }

    /// (s, π(s)), `[observation + action, n]`.
    pub(super) fn own_inputs(&self) -> &Strips {
        &self.own_inputs
    }

    /// (s′, π′(s′)), `[observation + action, n]`.
    pub(super) fn next_inputs(&self) -> &Strips {
        &self.next_inputs
    }

    /// r, scaled, `[n, 1]`.
    pub(super) fn rewards(&self) -> &Tensor {
        &self.rewards
    }

    /// γ, `[n, 1]`.
    pub(super) fn discounts(&self) -> &Tensor {
        &self.discounts
    }

    /// Weights of the losses, `[n, 1]`.
    pub(super) fn weights(&self) -> &Tensor {
        &self.weights
    }

    /// Weighs the losses so.
    pub(super) fn set_weights(&mut self, weights: Vec<f32>) -> Result<()> {
        assert_eq!(weights.len(), self.len, "weights of a minibatch");
        self.weights = column(weights)?;
        Ok(())
    }

    /// Writes π(s), `[action, n]`, below s.
    pub(super) fn set_own_actions(&mut self, actions: &Strips) {
        self.own_inputs.set_rows(self.dims.observation, actions, 0..self.dims.action);
    }

    /// Writes π′(s′), `[action, n]`, below s′.
    pub(super) fn set_next_actions(&mut self, actions: &Strips) {
        self.next_inputs.set_rows(self.dims.observation, actions, 0..self.dims.action);
    }
}

/// Numbers of a line of cache.
const LINE: usize = 16;

/// Brings transitions near, many at once: copies are too long for the CPU to ask for the next row's memory meanwhile.
fn fetch(rows: &[Row<'_>]) {
    let mut seen = 0;
    for row in rows {
        for numbers in [row.observation, row.next_observation] {
            for line in numbers.chunks(LINE) {
                seen ^= line[0].to_bits();
            }
        }
    }
    std::hint::black_box(seen);
}

/// `[n, 1]`
pub(super) fn column(numbers: Vec<f32>) -> Result<Tensor> {
    let n = numbers.len();
    Tensor::from_vec(numbers, (n, 1), &Device::Cpu)
}
