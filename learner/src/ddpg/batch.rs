//! A minibatch as tensors that live as long as the learner, so that an update allocates none.
//!
//! | tensor | rows | shape |
//! |---|---|---|
//! | `inputs` | (s, a), then (s, π(s)) | `[2n, observation + action]` |
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
            inputs: zeros(2 * len, width)?,
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
            let (done, own) = numbers.split_at_mut(self.len * width);
            for ((row, done), own) in rows.iter().zip(done.chunks_exact_mut(width)).zip(own.chunks_exact_mut(width)) {
                done[..observation].copy_from_slice(row.observation);
                done[observation..].copy_from_slice(row.action);
                own[..observation].copy_from_slice(row.observation);
            }
        })?;
        write(&self.next_inputs, |numbers| {
            for (row, next) in rows.iter().zip(numbers.chunks_exact_mut(width)) {
                next[..observation].copy_from_slice(row.next_observation);
            }
        })?;
        write(&self.rewards, |numbers| {
            numbers.iter_mut().zip(rows).for_each(|(reward, row)| *reward = reward_scale * row.reward);
        })?;
        write(&self.discounts, |numbers| {
            numbers.iter_mut().zip(rows).for_each(|(discount, row)| *discount = row.discount);
        })?;
        Ok(())
    }

    /// Transitions, n.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// (s, a), `[n, observation + action]`.
    pub(super) fn state_actions(&self) -> Result<Tensor> {
        self.inputs.narrow(0, 0, self.len)
    }

    /// (s, a) and below them (s, π(s)), `[2n, observation + action]`.
    pub(super) fn both(&self) -> &Tensor {
        &self.inputs
    }

    /// s, `[n, observation]`.
    pub(super) fn observations(&self) -> Result<Tensor> {
        self.state_actions()?.narrow(1, 0, self.dims.observation)
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
        self.inputs.narrow(0, self.len, self.len)?.slice_set(actions, 1, self.dims.observation)
    }

    /// Writes π′(s′) beside s′.
    pub(super) fn set_next_actions(&self, actions: &Tensor) -> Result<()> {
        self.next_inputs.slice_set(actions, 1, self.dims.observation)
    }
}
