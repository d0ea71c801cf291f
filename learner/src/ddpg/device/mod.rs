//! The trainer on a device: the updates of `update` as launches over one arena, several updates at a time.
//!
//! What is random happens on the host, as it does for the CPU's trainer, so both draw the same minibatches and noise.
//! The device has a copy of the replay memory, so a minibatch is sent as slots. Updates are queued one behind the other
//! while the host draws the next; what they found comes back in one transfer when the last is through. Nothing waits in
//! between: an update whose losses or gradients are not finite changes nothing on the device, and is counted when that
//! is read. How many go together does not show in the bits. Prioritised replay draws by what the last update found, so
//! there they go one by one.
//!
//! `plan` says what an update is, `cuda` does it on a GPU, `host` on the calling thread, for tests.

#[cfg(feature = "cuda")]
mod cuda;
mod host;
mod launches;
mod plan;

use super::error::Error;
use super::optimizer::{corrected_rate, root_scale};
use super::priorities::{Draw, Priorities};
use super::rows::{Row, Span};
use super::snapshot::{self, Counters, Snapshot, Spanned, Stored};
use super::update::{self, Ddpg, Update};
use crate::replay::{Identity, Replay};
use herd_common::caps;
use herd_common::config::ddpg::Config;
use herd_common::policy::Layer;
use herd_common::seed::Seed;
use herd_common::spaces::Dims;
use launches::{Launch, REPORT};
use plan::{Place, Plan};
use std::fmt::Debug;

/// What computes the launches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Device {
    /// The calling thread, slowly: for tests, in every build.
    Host,
    /// The first GPU; `CUDA_VISIBLE_DEVICES` says which that is.
    Cuda,
}

impl Device {
    /// Fails if this program or machine has none.
    fn check(self) -> Result<(), Error> {
        match self {
            Self::Host => Ok(()),
            #[cfg(feature = "cuda")]
            Self::Cuda => cuda::check(),
            #[cfg(not(feature = "cuda"))]
            Self::Cuda => Err(Error::NoCuda),
        }
    }
}

/// An arena and a copy of the replay memory on a device. What it is told happens in order; only `read` waits.
trait Machine: Debug + Send {
    /// Puts numbers into the arena.
    fn write(&mut self, at: u32, numbers: &[f32]) -> Result<(), Error>;
    /// Numbers of the arena, once all is done.
    fn read(&self, at: u32, count: usize) -> Result<Vec<f32>, Error>;
    /// Makes room for a replay memory of so many numbers, and forgets the old one if that is too small.
    fn make_room(&mut self, numbers: usize) -> Result<(), Error>;
    /// Puts numbers into the copy of the replay memory.
    fn remember(&mut self, at: usize, numbers: &[f32]) -> Result<(), Error>;
    /// Does one update by the program of this number; `feed` is the update's number in the round, then a slot of the
    /// replay memory for every transition.
    fn run(&mut self, number: usize, program: &[Launch], feed: &[u32]) -> Result<(), Error>;
}

/// The learner's networks on a device, and all that they need to go on learning.
#[derive(Debug)]
pub struct OnDevice {
    config: Config,
    dims: Dims,
    seed: Seed,
    plan: Plan,
    machine: Box<dyn Machine>,
    counters: Counters,
    /// Of prioritised replay.
    priorities: Option<Priorities>,
    /// The memory whose copy the device has, and how many transitions it had been given.
    remembered: Option<(Identity, u64)>,
}

impl OnDevice {
    /// The networks that `Ddpg::new` starts with, on this device.
    pub fn new(config: &Config, dims: Dims, seed: Seed, device: Device) -> Result<Self, Error> {
        let plan = Plan::new(config, dims, updates_at_once(config))?;
        device.check()?;
        let model = Ddpg::new(config, dims, seed)?;
        let mut fresh = Self {
            config: config.clone(),
            dims,
            seed,
            machine: machine(device, plan.len, config)?,
            plan,
            counters: Counters::default(),
            priorities: model.priorities.clone(),
            remembered: None,
        };
        // Now, so that a lack of memory shows before the run does.
        fresh.machine.make_room(config.replay_capacity * Replay::width(dims.observation, dims.action))?;
        fresh.machine.write(fresh.plan.weights, &vec![1.0; config.batch_size])?;
        fresh.load(&model.save()?)?;
        Ok(fresh)
    }

    /// Fails if this program or machine has no such device, or networks and minibatch are too large for any.
    pub fn check(config: &Config, dims: Dims, device: Device) -> Result<(), Error> {
        Plan::new(config, dims, updates_at_once(config))?;
        device.check()
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
    pub fn policy_layers(&self) -> Result<Vec<Layer>, Error> {
        snapshot::policy_layers(&self.held(&self.plan.actor)?)
    }

    /// As `Ddpg::save`.
    pub fn save(&self) -> Result<Snapshot, Error> {
        let actor = self.held(&self.plan.actor)?;
        let critics = self.plan.critics.iter().map(|place| self.held(place)).collect::<Result<Vec<_>, _>>()?;
        Ok(snapshot::save(snapshot::named(&actor, &critics), self.priorities.as_ref(), self.counters))
    }

    /// As `Ddpg::load`; the snapshot may come from any device.
    pub fn load(&mut self, snapshot: &Snapshot) -> Result<(), Error> {
        let networks = snapshot::named(&self.plan.actor, &self.plan.critics);
        let (rows, priorities) = snapshot::parts(snapshot, networks, self.priorities.as_ref())?;
        for (place, rows) in std::iter::once(&self.plan.actor).chain(&self.plan.critics).zip(rows) {
            for (i, row) in (0..).zip(rows.chunks_exact(place.moved.parameters as usize)) {
                self.machine.write(place.moved.rows + i * place.moved.stride, row)?;
            }
        }
        self.counters = snapshot.counters;
        self.priorities = priorities;
        Ok(())
    }

    /// Learns from up to `most` minibatches of `replay`, at least one, and says what each update found.
    ///
    /// A loss or gradient that is not finite leaves all weights as they were; `caps::SKIPPED_UPDATES` of them in a row
    /// are an error.
    pub fn learn(&mut self, replay: &Replay, most: u64) -> Result<Vec<Update>, Error> {
        update::check(replay, self.dims)?;
        self.remember(replay)?;
        let count = usize::try_from(most).unwrap_or(usize::MAX).clamp(1, updates_at_once(&self.config));
        self.machine.write(self.plan.schedule, &self.schedule())?;
        let mut draws = Vec::new();
        for (in_round, number) in (0..count as u32).zip(self.counters.updates..) {
            let feed;
            (feed, draws) = self.draw(replay, in_round, number)?;
            let program = usize::from(self.moves_actor(number + 1));
            self.machine.run(program, &self.plan.programs[program], &feed)?;
        }
        let report = self.machine.read(self.plan.report, count * REPORT)?;
        let errors =
            if draws.is_empty() { Vec::new() } else { self.machine.read(self.plan.errors, self.config.batch_size)? };
        report.chunks_exact(REPORT).map(|report| self.account(report, &errors, &draws)).collect()
    }

    /// Whether the actor moves in the update that makes `updates` of them.
    fn moves_actor(&self, updates: u64) -> bool {
        updates.is_multiple_of(self.config.actor_every)
    }

    /// Brings the device's copy of the replay memory up to date.
    fn remember(&mut self, replay: &Replay) -> Result<(), Error> {
        let known = match &self.remembered {
            Some((identity, pushed)) if identity == replay.identity() => *pushed,
            _ => {
                self.machine.make_room(replay.capacity() * replay.row_width())?;
                0
            }
        };
        for (slot, numbers) in replay.since(known) {
            self.machine.remember(slot * replay.row_width(), numbers)?;
        }
        self.remembered = Some((replay.identity().clone(), replay.pushed()));
        Ok(())
    }

    /// Rates and root scales of the steps that this round may take, and that none is taken yet, as `Plan::schedule`.
    fn schedule(&self) -> Vec<f32> {
        let (counters, updates) = (self.counters, updates_at_once(&self.config));
        let mut schedule = Vec::with_capacity(6 * updates + 2);
        let steps = [(self.config.critic_rate, counters.critic_steps), (self.config.actor_rate, counters.actor_steps)];
        for (rate, taken) in steps {
            let counts = taken + 1..=taken + updates as u64;
            schedule.extend(counts.flat_map(|count| [corrected_rate(rate, count), root_scale(count)]));
        }
        schedule.resize(6 * updates + 2, 0.0);
        schedule
    }

    /// Draws the minibatch of update `number` and sends all of it but the feed; says what was drawn if replay is
    /// prioritised.
    fn draw(&mut self, replay: &Replay, in_round: u32, number: u64) -> Result<(Vec<u32>, Vec<Draw>), Error> {
        let (config, mut draws) = (&self.config, Vec::new());
        let mut rng = self.seed.child("update", number).rng();
        let mut feed = Vec::with_capacity(1 + config.batch_size);
        feed.push(in_round);
        let slot = |age_rank| replay.slot(age_rank) as u32;
        if let Some(priorities) = &mut self.priorities {
            priorities.grow(replay.pushed());
            draws = priorities.draw(config.batch_size, &mut rng);
            feed.extend(draws.iter().map(|draw| slot(draw.age_rank)));
            let weights: Vec<f32> = draws.iter().map(|draw| draw.weight).collect();
            self.machine.write(self.plan.weights, &weights)?;
        } else {
            feed.extend(replay.draw_ranks(config.batch_size, &mut rng).map(slot));
        }
        if let Some(noise) = self.plan.noise {
            let numbers = update::smoothing(config, config.batch_size * self.dims.action, &mut rng);
            self.machine.write(noise, &numbers)?;
        }
        Ok((feed, draws))
    }

    /// A network as it stands on the device now.
    fn held(&self, place: &Place) -> Result<Held, Error> {
        let stride = place.moved.stride as usize;
        let numbers = self.machine.read(place.moved.rows, Row::LASTING.len() * stride)?;
        Ok(Held { spans: place.spans.clone(), stride, numbers })
    }

    /// Counts one update as `Ddpg::update` does.
    fn account(&mut self, report: &[f32], errors: &[f32], draws: &[Draw]) -> Result<Update, Error> {
        let &[critic_loss, actor_loss, mean_value, ok] = report else { unreachable!("a report is {REPORT} numbers") };
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

/// Updates that may go together.
fn updates_at_once(config: &Config) -> usize {
    let fit = caps::TRANSITIONS_PER_ROUND / config.batch_size;
    if config.priority_alpha > 0.0 { 1 } else { fit.clamp(1, caps::UPDATES_PER_ROUND) }
}

fn machine(device: Device, len: usize, config: &Config) -> Result<Box<dyn Machine>, Error> {
    let reward_scale = config.reward_scale as f32;
    match device {
        Device::Host => Ok(Box::new(host::Host::new(len, reward_scale))),
        #[cfg(feature = "cuda")]
        Device::Cuda => Ok(Box::new(cuda::Cuda::new(len, config.batch_size, reward_scale)?)),
        #[cfg(not(feature = "cuda"))]
        Device::Cuda => Err(Error::NoCuda),
    }
}

/// A network's lasting rows, read off the device.
struct Held {
    spans: Vec<Span>,
    /// From one row to the next.
    stride: usize,
    numbers: Vec<f32>,
}

impl Spanned for Place {
    fn spans(&self) -> &[Span] {
        &self.spans
    }
}

impl Spanned for Held {
    fn spans(&self) -> &[Span] {
        &self.spans
    }
}

impl Stored for Held {
    fn read(&self, row: Row, span: &Span) -> Vec<f32> {
        self.numbers[row as usize * self.stride + span.start..][..span.len()].to_vec()
    }
}

#[cfg(test)]
mod tests;
