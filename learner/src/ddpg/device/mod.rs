//! The trainer on any candle device: the updates of `update`, in candle's own operations, several at a time.
//!
//! What is random happens on the host, as it does for the CPU's trainer, so both draw the same minibatches and noise.
//! Several updates go to the device in one transfer and are queued one behind the other; what they found comes back in
//! one transfer when the last is through. Nothing waits in between: an update whose losses or gradients are not finite
//! undoes itself on the device, and is counted when that is read. How many go together does not show in the bits.
//! Prioritised replay draws by what the last update found, so there they go one by one.

mod network;
mod upload;

use super::error::Error;
use super::losses;
use super::optimizer::kept;
use super::priorities::{Draw, Priorities};
use super::rows::Row;
use super::snapshot::{self, Counters, Snapshot};
use super::update::{self, Ddpg, Update};
use crate::replay::Replay;
use candle_core::{Device, Result, Tensor};
use herd_common::caps;
use herd_common::config::ddpg::Config;
use herd_common::policy::Layer;
use herd_common::seed::Seed;
use herd_common::spaces::Dims;
use network::{Network, Pass, Step, norm};
use upload::{Minibatch, Schedule, Sent, Upload};

/// The learner's networks on a device, and all that they need to go on learning.
#[derive(Debug)]
pub struct OnDevice {
    config: Config,
    dims: Dims,
    seed: Seed,
    device: Device,
    actor: Network,
    critics: Vec<Network>,
    counters: Counters,
    /// Of prioritised replay.
    priorities: Option<Priorities>,
    /// −1, 0 and 1, `[1]` each.
    constants: [Tensor; 3],
}

/// Numbers that each update reports before the errors: critic's loss, actor's loss, mean value, whether all is finite.
const REPORT: usize = 4;

/// Losses and gradients of one update, on the device.
struct Findings {
    /// `[1]` each.
    critic_loss: Tensor,
    actor_loss: Option<Tensor>,
    mean_value: Tensor,
    /// Gradient and its length, critic by critic.
    critics: Vec<(Tensor, Tensor)>,
    /// The same, if the actor is to move.
    actor: Option<(Tensor, Tensor)>,
    /// y − Q(s, a) of the first critic, `[n]`.
    errors: Tensor,
}

impl OnDevice {
    /// The networks that `Ddpg::new` starts with, on this device.
    pub fn new(config: &Config, dims: Dims, seed: Seed, device: &Device) -> std::result::Result<Self, Error> {
        let model = Ddpg::new(config, dims, seed)?;
        let constant = |x: f32| Tensor::new(&[x], device);
        let mut fresh = Self {
            config: config.clone(),
            dims,
            seed,
            device: device.clone(),
            actor: Network::like(&model.actor, device)?,
            critics: model.critics.iter().map(|critic| Network::like(critic, device)).collect::<Result<_>>()?,
            counters: Counters::default(),
            priorities: model.priorities.clone(),
            constants: [constant(-1.0)?, constant(0.0)?, constant(1.0)?],
        };
        fresh.load(&model.save()?)?;
        Ok(fresh)
    }

    /// Updates so far, skipped ones included.
    pub fn updates(&self) -> u64 {
        self.counters.updates
    }

    /// Updates skipped so far.
    pub fn skipped(&self) -> u64 {
        self.counters.skipped
    }

    /// The actor as plain data, every number finite.
    pub fn policy_layers(&self) -> std::result::Result<Vec<Layer>, Error> {
        snapshot::policy_layers(&self.actor)
    }

    /// As `Ddpg::save`.
    pub fn save(&self) -> std::result::Result<Snapshot, Error> {
        snapshot::save(snapshot::named(&self.actor, &self.critics), self.priorities.as_ref(), self.counters)
    }

    /// As `Ddpg::load`; the snapshot may come from any device.
    pub fn load(&mut self, snapshot: &Snapshot) -> std::result::Result<(), Error> {
        let networks = snapshot::named(&self.actor, &self.critics);
        let (arenas, priorities) = snapshot::parts(snapshot, networks, self.priorities.as_ref())?;
        for (network, numbers) in std::iter::once(&mut self.actor).chain(&mut self.critics).zip(arenas) {
            network.overwrite(&numbers)?;
        }
        self.counters = snapshot.counters;
        self.priorities = priorities;
        Ok(())
    }

    /// Learns from up to `most` minibatches of `replay`, at least one, and says what each update found.
    ///
    /// A loss or gradient that is not finite leaves all weights as they were; `caps::SKIPPED_UPDATES` of them in a row
    /// are an error.
    pub fn learn(&mut self, replay: &Replay, most: u64) -> std::result::Result<Vec<Update>, Error> {
        update::check(replay, self.dims)?;
        let count = usize::try_from(most).unwrap_or(usize::MAX).clamp(1, self.updates_at_once());
        let (upload, draws) = self.draw(replay, count);
        let Sent { minibatches, mut critics, mut actor } = upload.send(&self.device)?;
        let mut reports = Vec::with_capacity(count);
        let first = self.counters.updates;
        for (number, minibatch) in (first + 1..).zip(&minibatches) {
            reports.push(self.update(minibatch, self.moves_actor(number), &mut critics, &mut actor)?);
        }
        let report = Tensor::cat(&reports, 0)?.to_vec1::<f32>()?;
        let width = report.len() / count;
        report.chunks_exact(width).map(|report| self.account(report, &draws)).collect()
    }

    fn updates_at_once(&self) -> usize {
        let fit = caps::TRANSITIONS_PER_UPLOAD / self.config.batch_size;
        if self.priorities.is_some() { 1 } else { fit.clamp(1, caps::UPDATES_PER_UPLOAD) }
    }

    /// Whether the actor moves in the update that makes `updates` of them.
    fn moves_actor(&self, updates: u64) -> bool {
        updates.is_multiple_of(self.config.actor_every)
    }

    /// The minibatches of the next `count` updates; says what was drawn if replay is prioritised.
    fn draw(&mut self, replay: &Replay, count: usize) -> (Upload, Vec<Draw>) {
        let (config, counters) = (&self.config, self.counters);
        let (n, scale, noisy) = (config.batch_size, config.reward_scale as f32, config.smoothing_sigma > 0.0);
        let steps = [(config.critic_rate, counters.critic_steps), (config.actor_rate, counters.actor_steps)];
        let mut upload = Upload::new(count, n, self.dims, noisy, steps);
        let mut draws = Vec::new();
        for number in (counters.updates..).take(count) {
            let mut rng = self.seed.child("update", number).rng();
            let (rows, weights): (Vec<_>, Vec<_>) = if let Some(priorities) = &mut self.priorities {
                priorities.grow(replay.pushed());
                draws = priorities.draw(n, &mut rng);
                draws.iter().map(|draw| (replay.row(draw.age_rank), draw.weight)).unzip()
            } else {
                replay.draw(n, &mut rng).map(|row| (row, 1.0)).unzip()
            };
            let noise = if noisy { update::smoothing(config, n * self.dims.action, &mut rng) } else { Vec::new() };
            upload.push(&rows, scale, &weights, &noise);
        }
        (upload, draws)
    }

    /// One update; gives what it found, `[REPORT]` and the errors behind it if replay is prioritised.
    fn update(
        &mut self,
        minibatch: &Minibatch,
        moves_actor: bool,
        critics: &mut Schedule,
        actor: &mut Schedule,
    ) -> Result<Tensor> {
        let found = self.findings(minibatch, moves_actor)?;
        let ok = self.is_finite(&found)?;
        let target_rate = moves_actor.then_some(self.config.target_rate);
        let step = |schedule: &Schedule, keep: f64| {
            let (rate, root_scale) = schedule.next()?;
            Ok::<_, candle_core::Error>(Step { rate, root_scale, keep, clip: self.config.gradient_clip, target_rate })
        };
        let critic_step = step(critics, kept(self.config.critic_rate, self.config.critic_decay))?;
        for (critic, (gradient, norm)) in self.critics.iter_mut().zip(&found.critics) {
            critic.step(gradient, norm, &critic_step, &ok)?;
        }
        critics.count(&ok)?;
        if let Some((gradient, norm)) = &found.actor {
            self.actor.step(gradient, norm, &step(actor, 1.0)?, &ok)?;
            actor.count(&ok)?;
        }
        let actor_loss = found.actor_loss.unwrap_or_else(|| self.constants[1].clone());
        let mut report = vec![found.critic_loss, actor_loss, found.mean_value, ok.to_dtype(candle_core::DType::F32)?];
        if self.priorities.is_some() {
            report.push(found.errors);
        }
        Tensor::cat(&report, 0)
    }

    /// Losses and gradients; changes nothing.
    fn findings(&self, minibatch: &Minibatch, moves_actor: bool) -> Result<Findings> {
        let y = self.targets(minibatch)?;
        let inputs = Tensor::cat(&[&minibatch.observations, &minibatch.actions], 1)?;
        let (mut critics, mut losses, mut values) = (Vec::new(), Vec::new(), Vec::new());
        for critic in &self.critics {
            let pass = critic.forward(Row::Online, &inputs)?;
            let q = pass.output();
            losses.push(losses::critic(q, &y, &minibatch.weights)?.reshape(1)?);
            let deltas = critic.deltas(&pass, &losses::critic_gradient(q, &y, &minibatch.weights)?)?;
            critics.push(with_norm(&pass, &deltas)?);
            values.push(q.clone());
        }
        let guided = if moves_actor { Some(self.guide(minibatch)?) } else { None };
        let (actor_loss, actor) = guided.unzip();
        Ok(Findings {
            critic_loss: Tensor::cat(&losses, 0)?.mean_all()?.reshape(1)?,
            actor_loss,
            mean_value: values[0].mean_all()?.reshape(1)?,
            critics,
            actor,
            errors: (y - &values[0])?.flatten_all()?,
        })
    }

    /// y of eq 6, with TD3's smoothing and minimum, `[n, 1]`.
    fn targets(&self, minibatch: &Minibatch) -> Result<Tensor> {
        let [lowest, _, highest] = &self.constants;
        let pass = self.actor.forward(Row::Target, &minibatch.next_observations)?;
        let actions = match &minibatch.noise {
            None => pass.output().clone(),
            Some(noise) => (pass.output() + noise)?.broadcast_maximum(lowest)?.broadcast_minimum(highest)?,
        };
        let inputs = Tensor::cat(&[&minibatch.next_observations, &actions], 1)?;
        let mut values = self.critics[0].forward(Row::Target, &inputs)?.output().clone();
        for critic in &self.critics[1..] {
            values = values.minimum(critic.forward(Row::Target, &inputs)?.output())?;
        }
        losses::targets(&minibatch.rewards, &minibatch.discounts, &values)
    }

    /// The actor's loss, gradient and its length, by the first critic.
    fn guide(&self, minibatch: &Minibatch) -> Result<(Tensor, (Tensor, Tensor))> {
        let critic = &self.critics[0];
        let own = self.actor.forward(Row::Online, &minibatch.observations)?;
        let inputs = Tensor::cat(&[&minibatch.observations, own.output()], 1)?;
        let judged = critic.forward(Row::Online, &inputs)?;
        let deltas = critic.deltas(&judged, &losses::actor_gradient(judged.output())?)?;
        let gradient = critic.input_gradient(&deltas, self.dims.observation)?;
        let deltas = self.actor.deltas(&own, &gradient)?;
        Ok((losses::actor(judged.output())?.reshape(1)?, with_norm(&own, &deltas)?))
    }

    /// Whether all losses and gradients are finite, `[1]` of u8.
    fn is_finite(&self, found: &Findings) -> Result<Tensor> {
        let norms = found.critics.iter().chain(&found.actor).map(|(_, norm)| norm);
        let all: Vec<&Tensor> =
            [&found.critic_loss, &found.mean_value].into_iter().chain(&found.actor_loss).chain(norms).collect();
        // 0 · x is 0 for every finite x, however large the sum of all would be.
        Tensor::cat(&all, 0)?.affine(0.0, 0.0)?.sum_all()?.reshape(1)?.eq(&self.constants[1])
    }

    /// Counts one update as `Ddpg::update` does.
    fn account(&mut self, report: &[f32], draws: &[Draw]) -> std::result::Result<Update, Error> {
        let (&[critic_loss, actor_loss, mean_value, ok], errors) =
            report.split_first_chunk::<REPORT>().expect("a report has this many numbers");
        self.counters.updates += 1;
        let moves_actor = self.moves_actor(self.counters.updates);
        let counters = &mut self.counters;
        let skipped = ok == 0.0;
        if skipped {
            counters.skipped += 1;
            counters.skipped_in_row += 1;
            if counters.skipped_in_row >= caps::SKIPPED_UPDATES {
                return Err(Error::Diverged { skipped: counters.skipped_in_row, update: counters.updates - 1 });
            }
        } else {
            counters.skipped_in_row = 0;
            counters.critic_steps += 1;
            counters.actor_steps += u64::from(moves_actor);
            if let Some(priorities) = &mut self.priorities {
                priorities.note(draws, errors);
            }
        }
        Ok(Update { critic_loss, actor_loss: moves_actor.then_some(actor_loss), mean_value, skipped })
    }
}

/// The gradient of a pass and its length.
fn with_norm(pass: &Pass, deltas: &[Tensor]) -> Result<(Tensor, Tensor)> {
    let gradient = Network::gradient(pass, deltas)?;
    let norm = norm(&gradient)?;
    Ok((gradient, norm))
}

#[cfg(test)]
mod tests;
