//! A minibatch as tensors that live as long as the learner, so that an update allocates none.
//!
//! | tensor | rows | shape |
//! |---|---|---|
//! | `inputs` | (s, a) | `[n, observation + action]` |
//! | `own_inputs` | (s, π(s)) | `[n, observation + action]` |
//! | `next_inputs` | (s′, π′(s′)) | `[n, observation + action]` |
//! | `rewards`, `discounts` | r in units that are learned, γ | `[n, 1]` |
//! | `weights` | of each transition's loss; 1 unless replay is prioritised | `[n, 1]` |
//!
//! Each row is copied once, from the replay memory to where the critics read it; actors read views of the same rows.

use super::error::Error;
use super::kernels::write;
use crate::replay::Row;
use candle_core::{DType, Device, Result, Tensor};
use herd_common::spaces::Dims;

/// The tensors of one minibatch.
#[derive(Debug)]
pub struct Batch {
    len: usize,
    dims: Dims,
    inputs: Tensor,
    own_inputs: Tensor,
    next_inputs: Tensor,
    rewards: Tensor,
    discounts: Tensor,
    weights: Tensor,
}

impl Batch {
    /// Room for `len` transitions.
    pub fn new(len: usize, dims: Dims) -> std::result::Result<Self, Error> {
        let zeros = |rows, width| Tensor::zeros((rows, width), DType::F32, &Device::Cpu);
        let width = dims.observation + dims.action;
        Ok(Self {
            len,
            dims,
            inputs: zeros(len, width)?,
            own_inputs: zeros(len, width)?,
            next_inputs: zeros(len, width)?,
            rewards: zeros(len, 1)?,
            discounts: zeros(len, 1)?,
            weights: Tensor::ones((len, 1), DType::F32, &Device::Cpu)?,
        })
    }

    /// Takes these transitions, of which there are as many as there is room for; rewards are multiplied by `reward_scale`.
    pub fn fill(&self, rows: &[Row<'_>], reward_scale: f32) -> std::result::Result<(), Error> {
        assert_eq!(rows.len(), self.len, "transitions of a minibatch");
        let (width, observation) = (self.dims.observation + self.dims.action, self.dims.observation);
        write(&self.inputs, |numbers| {
            for (row, input) in rows.iter().zip(numbers.chunks_exact_mut(width)) {
                input[..observation].copy_from_slice(row.observation);
                input[observation..].copy_from_slice(row.action);
            }
        })?;
        for (inputs, next) in [(&self.own_inputs, false), (&self.next_inputs, true)] {
            write(inputs, |numbers| {
                for (row, input) in rows.iter().zip(numbers.chunks_exact_mut(width)) {
                    let state = if next { row.next_observation } else { row.observation };
                    input[..observation].copy_from_slice(state);
                }
            })?;
        }
        write(&self.rewards, |numbers| {
            numbers.iter_mut().zip(rows).for_each(|(reward, row)| *reward = reward_scale * row.reward);
        })?;
        write(&self.discounts, |numbers| {
            numbers.iter_mut().zip(rows).for_each(|(discount, row)| *discount = row.discount);
        })?;
        Ok(())
    }

    /// (s, a), `[n, observation + action]`.
    pub(super) fn inputs(&self) -> &Tensor {
        &self.inputs
    }

    /// (s, π(s)), `[n, observation + action]`.
    pub(super) fn own_inputs(&self) -> &Tensor {
        &self.own_inputs
    }

    /// s, `[n, observation]`.
    pub(super) fn observations(&self) -> Result<Tensor> {
        self.inputs.narrow(1, 0, self.dims.observation)
    }

    /// (s′, π′(s′)), `[n, observation + action]`.
    pub(super) fn next_inputs(&self) -> &Tensor {
        &self.next_inputs
    }

    /// s′, `[n, observation]`.
    pub(super) fn next_observations(&self) -> Result<Tensor> {
        self.next_inputs.narrow(1, 0, self.dims.observation)
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
    pub(super) fn set_weights(&self, weights: &[f32]) -> Result<()> {
        write(&self.weights, |numbers| numbers.copy_from_slice(weights))
    }

    /// Writes π(s) beside s.
    pub(super) fn set_own_actions(&self, actions: &Tensor) -> Result<()> {
        self.own_inputs.slice_set(actions, 1, self.dims.observation)
    }

    /// Writes π′(s′) beside s′.
    pub(super) fn set_next_actions(&self, actions: &Tensor) -> Result<()> {
        self.next_inputs.slice_set(actions, 1, self.dims.observation)
    }
}
