//! The minibatches of several updates and the rates of their steps, gathered in one buffer and sent in one transfer.
//!
//! | part | shape | how often |
//! |---|---|---|
//! | rate and root scale of the critics' next steps, of the actor's | `[updates, 2]` | 1 each |
//! | s, a, r in units that are learned, γ, s′ | `[n, observation]`, `[n, action]`, `[n, 1]`, `[n, 1]`, `[n, observation]` | an update |
//! | weights of the losses | `[n, 1]` | an update |
//! | noise on target actions, if there is any | `[n, action]` | an update |

use super::super::optimizer::{corrected_rate, root_scale};
use crate::replay::Row;
use candle_core::{DType, Device, Result, Tensor};
use herd_common::spaces::Dims;

/// One minibatch on the device; see the module's table.
pub(super) struct Minibatch {
    pub(super) observations: Tensor,
    pub(super) actions: Tensor,
    pub(super) rewards: Tensor,
    pub(super) discounts: Tensor,
    pub(super) next_observations: Tensor,
    pub(super) weights: Tensor,
    pub(super) noise: Option<Tensor>,
}

/// Rates of a network's next steps, and how many of them were taken. A step that turns out to be none does not count,
/// which only the device knows until the losses are read.
pub(super) struct Schedule {
    /// `[updates, 2]`
    rates: Tensor,
    /// `[1]`, u32.
    taken: Tensor,
}

impl Schedule {
    /// Rate and root scale of the next step, `[1]` each.
    pub(super) fn next(&self) -> Result<(Tensor, Tensor)> {
        let row = self.rates.index_select(&self.taken, 0)?.flatten_all()?;
        Ok((row.narrow(0, 0, 1)?, row.narrow(0, 1, 1)?))
    }

    /// Counts a step where `ok`, `[1]` of u8, is 1.
    pub(super) fn count(&mut self, ok: &Tensor) -> Result<()> {
        self.taken = (&self.taken + ok.to_dtype(DType::U32)?)?;
        Ok(())
    }
}

/// What stands on the device once it is sent.
pub(super) struct Sent {
    pub(super) minibatches: Vec<Minibatch>,
    pub(super) critics: Schedule,
    pub(super) actor: Schedule,
}

/// The buffer on the host.
pub(super) struct Upload {
    updates: usize,
    n: usize,
    dims: Dims,
    noisy: bool,
    numbers: Vec<f32>,
}

impl Upload {
    /// Room for this many minibatches of `n` transitions. `steps` are a network's learning rate and the steps it has
    /// taken: first the critics', then the actor's.
    pub(super) fn new(updates: usize, n: usize, dims: Dims, noisy: bool, steps: [(f64, u64); 2]) -> Self {
        let width = 2 * dims.observation + dims.action * (1 + usize::from(noisy)) + 3;
        let mut numbers = Vec::with_capacity(updates * (4 + n * width));
        for (rate, taken) in steps {
            let counts = taken + 1..=taken + updates as u64;
            numbers.extend(counts.flat_map(|count| [corrected_rate(rate, count), root_scale(count)]));
        }
        Self { updates, n, dims, noisy, numbers }
    }

    /// Takes one minibatch; rewards are multiplied by `reward_scale`.
    pub(super) fn push(&mut self, rows: &[Row<'_>], reward_scale: f32, weights: &[f32], noise: &[f32]) {
        assert_eq!(rows.len(), self.n, "transitions of a minibatch");
        assert_eq!(weights.len(), self.n, "weights of a minibatch");
        assert_eq!(noise.len(), if self.noisy { self.n * self.dims.action } else { 0 }, "noise of a minibatch");
        self.numbers.extend(rows.iter().flat_map(|row| row.observation));
        self.numbers.extend(rows.iter().flat_map(|row| row.action));
        self.numbers.extend(rows.iter().map(|row| reward_scale * row.reward));
        self.numbers.extend(rows.iter().map(|row| row.discount));
        self.numbers.extend(rows.iter().flat_map(|row| row.next_observation));
        self.numbers.extend_from_slice(weights);
        self.numbers.extend_from_slice(noise);
    }

    /// Carries all of it to the device.
    pub(super) fn send(self, device: &Device) -> Result<Sent> {
        let (n, dims, count) = (self.n, self.dims, self.numbers.len());
        let all = Tensor::from_vec(self.numbers, count, device)?;
        let mut at = 0;
        let mut take = |rows: usize, width: usize| -> Result<Tensor> {
            at += rows * width;
            all.narrow(0, at - rows * width, rows * width)?.reshape((rows, width))
        };
        let mut schedule = || -> Result<Schedule> {
            Ok(Schedule { rates: take(self.updates, 2)?, taken: Tensor::zeros(1, DType::U32, device)? })
        };
        let (critics, actor) = (schedule()?, schedule()?);
        let mut minibatch = || -> Result<Minibatch> {
            Ok(Minibatch {
                observations: take(n, dims.observation)?,
                actions: take(n, dims.action)?,
                rewards: take(n, 1)?,
                discounts: take(n, 1)?,
                next_observations: take(n, dims.observation)?,
                weights: take(n, 1)?,
                noise: if self.noisy { Some(take(n, dims.action)?) } else { None },
            })
        };
        let minibatches = (0..self.updates).map(|_| minibatch()).collect::<Result<_>>()?;
        Ok(Sent { minibatches, critics, actor })
    }
}
