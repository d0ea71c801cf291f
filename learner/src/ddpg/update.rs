//! One step of learning: paper eqs 6–9, with TD3's parts where the configuration asks for them.
//!
//! | symbol | name | shape |
//! |---|---|---|
//! | s, a, r, γ, s′ | a minibatch of n transitions, see `batch` | – |
//! | π, Q | actor, critic (one or two) | `[action, n]`, `[1, n]` |
//! | π′, Q′ | their target copies | the same |
//!
//! Both losses' gradients are taken at the same weights and applied together, so an update happens whole or not at
//! all. The critic is through with (s, a), backward pass included, before it meets (s, π(s)): half the memory stays in
//! nearer caches. TD3 (Fujimoto et al. 2018): y uses the lower of two target critics at a′ = clip(π′(s′) + clip(noise)),
//! and actor and targets move every `actor_every` updates.

use super::batch::{Batch, column};
use super::error::Error;
use super::kernels::Activation;
use super::losses;
use super::networks::{Head, Network, Pass};
use super::optimizer::{Step, apply};
use super::priorities::{Draw, Priorities};
use super::rows::Row;
use super::snapshot::{self, Counters};
use super::strips::{Piece, Strips};
use crate::replay::Replay;
use candle_core::Tensor;
use herd_common::caps;
use herd_common::config::ddpg::Config;
use herd_common::policy::Layer;
use herd_common::seed::Seed;
use herd_common::spaces::Dims;
use rand::{Rng, RngExt};
use rand_distr::StandardNormal;

/// What one update reports. Values and losses are in units of scaled reward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Update {
    /// Eq 6, averaged over the critics.
    pub critic_loss: f32,
    /// −mean Q(s, π(s)); only of updates that move the actor.
    pub actor_loss: Option<f32>,
    /// Mean Q(s, a) over the minibatch.
    pub mean_value: f32,
    /// A loss or gradient was not finite, so nothing was changed.
    pub skipped: bool,
}

/// The learner's networks and all that they need to go on learning.
#[derive(Debug)]
pub struct Ddpg {
    pub(super) config: Config,
    pub(super) dims: Dims,
    pub(super) seed: Seed,
    pub(super) actor: Network,
    pub(super) critics: Vec<Network>,
    pub(super) counters: Counters,
    pub(super) batch: Batch,
    /// Of prioritised replay.
    pub(super) priorities: Option<Priorities>,
    /// Room for n transitions on their way through the actor.
    actor_pass: Pass,
    /// Room for n transitions on their way through any critic.
    critic_pass: Pass,
    /// Room for a strip of what the way back turns over.
    room: Vec<Piece>,
}

/// The networks that a configuration asks for. A critic's last layer is linear.
pub(super) struct Shapes {
    /// Widths, input first.
    pub(super) actor: Vec<usize>,
    /// What follows the actor's last sum.
    pub(super) squash: Activation,
    /// Widths of every critic.
    pub(super) critic: Vec<usize>,
    pub(super) critics: u64,
}

impl Shapes {
    pub(super) fn new(config: &Config, dims: Dims) -> Self {
        let widths = |input, output| [&[input], config.hidden.as_slice(), &[output]].concat();
        Self {
            actor: widths(dims.observation, dims.action),
            squash: if config.open_box { Activation::OpenTanh } else { Activation::Tanh },
            critic: widths(dims.observation + dims.action, 1),
            critics: if config.twin_critic { 2 } else { 1 },
        }
    }
}

/// What one update found out before it changes a weight; the gradients themselves stand in the networks.
pub(super) struct Findings {
    pub(super) update: Update,
    /// Lengths of the critics' gradients.
    critics: Vec<f32>,
    /// Length of the actor's gradient, if the actor is to move.
    actor: Option<f32>,
    /// y − Q(s, a) of the first critic, `[n]`, if replay is prioritised.
    errors: Vec<f32>,
}

impl Ddpg {
    /// Fresh networks; every random number descends from `seed`.
    pub fn new(config: &Config, dims: Dims, seed: Seed) -> Result<Self, Error> {
        let Shapes { actor, squash, critic, critics } = Shapes::new(config, dims);
        let head = |activation| Head { activation, init: config.output_init };
        let actor = Network::new(&actor, head(squash), seed.child("actor", 0));
        let critics: Vec<Network> =
            (0..critics).map(|i| Network::new(&critic, head(Activation::Linear), seed.child("critic", i))).collect();
        Ok(Self {
            config: config.clone(),
            dims,
            seed,
            counters: Counters::default(),
            batch: Batch::new(config.batch_size, dims)?,
            priorities: (config.priority_alpha > 0.0)
                .then(|| Priorities::new(config.priority_alpha, config.priority_beta, config.replay_capacity)),
            actor_pass: actor.pass(config.batch_size),
            critic_pass: critics[0].pass(config.batch_size),
            room: vec![Piece::ZERO; config.batch_size],
            actor,
            critics,
        })
    }

    /// Updates so far, skipped ones included.
    pub fn updates(&self) -> u64 {
        self.counters.updates
    }

    /// Updates skipped so far.
    pub fn skipped(&self) -> u64 {
        self.counters.skipped
    }

    /// Learns from one minibatch of `replay`.
    ///
    /// A loss or gradient that is not finite leaves all weights as they were; `caps::SKIPPED_UPDATES` of them in a row
    /// are an error.
    pub fn update(&mut self, replay: &Replay) -> Result<Update, Error> {
        check(replay, self.dims)?;
        let mut rng = self.seed.child("update", self.counters.updates).rng();
        let draws = self.draw(replay, &mut rng)?;
        self.counters.updates += 1;
        let targets = self.targets(&mut rng)?;
        let moves_actor = self.counters.updates.is_multiple_of(self.config.actor_every);
        let mut found = self.findings(&targets, moves_actor)?;
        found.update.skipped = !found.is_finite();
        if found.update.skipped {
            self.counters.skipped += 1;
            self.counters.skipped_in_row += 1;
            if self.counters.skipped_in_row >= caps::SKIPPED_UPDATES {
                return Err(Error::Diverged {
                    skipped: self.counters.skipped_in_row,
                    update: self.counters.updates - 1,
                });
            }
        } else {
            self.counters.skipped_in_row = 0;
            self.apply(&found);
            if let Some(priorities) = &mut self.priorities {
                priorities.note(&draws, &found.errors);
            }
        }
        Ok(found.update)
    }

    /// Fills the batch; says what was drawn if replay is prioritised.
    fn draw(&mut self, replay: &Replay, rng: &mut impl Rng) -> Result<Vec<Draw>, Error> {
        let (n, scale) = (self.config.batch_size, self.config.reward_scale as f32);
        let Some(priorities) = &mut self.priorities else {
            self.batch.fill(&replay.draw(n, rng).collect::<Vec<_>>(), scale)?;
            return Ok(Vec::new());
        };
        priorities.grow(replay.pushed());
        let draws = priorities.draw(n, rng);
        self.batch.fill(&draws.iter().map(|draw| replay.row(draw.age_rank)).collect::<Vec<_>>(), scale)?;
        self.batch.set_weights(draws.iter().map(|draw| draw.weight).collect())?;
        Ok(draws)
    }

    /// The actor's action for one observation.
    pub fn act(&self, observation: &[f32]) -> Vec<f32> {
        answer(&self.actor, observation)
    }

    /// The first critic's Q(s, a), in units of scaled reward.
    pub fn value(&self, observation: &[f32], action: &[f32]) -> f32 {
        answer(&self.critics[0], &[observation, action].concat())[0]
    }

    /// The actor as plain data, every number finite.
    pub fn policy_layers(&self) -> Result<Vec<Layer>, Error> {
        snapshot::policy_layers(&self.actor)
    }

    /// Losses and gradients for the batch; changes nothing that lasts.
    pub(super) fn findings(&mut self, targets: &Tensor, moves_actor: bool) -> Result<Findings, Error> {
        let mut critics = Vec::with_capacity(self.critics.len());
        let mut update = Update { critic_loss: 0.0, actor_loss: None, mean_value: 0.0, skipped: false };
        let mut errors = Vec::new();
        for i in 0..self.critics.len() {
            let judged = self.judge(i, targets)?;
            update.critic_loss += judged.loss / self.critics.len() as f32;
            if i == 0 {
                errors = judged.errors;
                update.mean_value = judged.mean_value;
            }
            critics.push(judged.norm);
        }
        let mut actor = None;
        if moves_actor {
            let (loss, norm) = self.guide()?;
            update.actor_loss = Some(loss);
            actor = Some(norm);
        }
        Ok(Findings { update, critics, actor, errors })
    }

    /// y of eq 6, with TD3's smoothing and minimum.
    pub(super) fn targets(&mut self, rng: &mut impl Rng) -> Result<Tensor, Error> {
        let batch = &mut self.batch;
        let mut actions = self.actor.answer(Row::Target, batch.next_inputs());
        if self.config.smoothing_sigma > 0.0 {
            smooth(&mut actions, &self.config, rng);
        }
        batch.set_next_actions(&actions);
        let values = self.critics.iter().map(|critic| critic.answer(Row::Target, batch.next_inputs()).row(0));
        let lowest = values.reduce(|a, b| a.into_iter().zip(b).map(|(a, b)| lower(a, b)).collect());
        let next_values = column(lowest.expect("there is at least one critic"))?;
        Ok(losses::targets(batch.rewards(), batch.discounts(), &next_values)?)
    }

    /// One critic's loss and gradient.
    fn judge(&mut self, critic: usize, y: &Tensor) -> Result<Judged, Error> {
        let Self { batch, critic_pass: pass, room, .. } = self;
        let critic = &mut self.critics[critic];
        critic.forward(batch.inputs(), pass);
        let values = &column(pass.output().row(0))?;
        let loss = losses::critic(values, y, batch.weights())?.to_scalar()?;
        let errors = if self.priorities.is_some() { (y - values)?.flatten_all()?.to_vec1()? } else { Vec::new() };
        let mean_value = values.mean_all()?.to_scalar()?;
        let gradient = row(&losses::critic_gradient(values, y, batch.weights())?)?;
        let norm = critic.gradients(batch.inputs_by_row().view(), pass, &gradient, room);
        Ok(Judged { loss, mean_value, norm, errors })
    }

    /// The actor's loss and gradient, by the first critic; gives the loss and the gradient's length.
    fn guide(&mut self) -> Result<(f32, f32), Error> {
        let Self { actor, batch, actor_pass, critic_pass: pass, room, .. } = self;
        actor.forward(batch.inputs(), actor_pass);
        batch.set_own_actions(actor_pass.output());
        let critic = &self.critics[0];
        critic.forward(batch.own_inputs(), pass);
        let values = &column(pass.output().row(0))?;
        let loss = losses::actor(values)?.to_scalar()?;
        critic.deltas(pass, &row(&losses::actor_gradient(values)?)?);
        let mut gradient = Strips::new(self.dims.action, self.config.batch_size);
        critic.input_gradient(pass, self.dims.observation, &mut gradient);
        Ok((loss, actor.gradients(batch.observations_by_row().view(), actor_pass, &gradient, room)))
    }

    fn apply(&mut self, found: &Findings) {
        self.counters.critic_steps += 1;
        let step = Step {
            rate: self.config.critic_rate,
            count: self.counters.critic_steps,
            decay: self.config.critic_decay,
            clip: self.config.gradient_clip,
            target_rate: found.actor.is_some().then_some(self.config.target_rate),
        };
        // The actor first: its gradient was written last and is still near.
        if let Some(norm) = found.actor {
            self.counters.actor_steps += 1;
            let step = Step { rate: self.config.actor_rate, decay: 0.0, count: self.counters.actor_steps, ..step };
            apply(&mut self.actor, norm, step);
        }
        for (critic, norm) in self.critics.iter_mut().zip(&found.critics) {
            apply(critic, *norm, step);
        }
    }
}

/// What a network answers to one input.
fn answer(network: &Network, input: &[f32]) -> Vec<f32> {
    let mut x = Strips::new(input.len(), 1);
    input.iter().enumerate().for_each(|(row, number)| x.set_row(row, &[*number]));
    let answer = network.answer(Row::Online, &x);
    (0..answer.rows()).map(|row| answer.view().at(row, 0)).collect()
}

/// The lower of two values; NaN if either is, so that the update is skipped whichever critic is out of order.
fn lower(first: f32, second: f32) -> f32 {
    if second < first || second.is_nan() { second } else { first }
}

/// `[1, n]` of `[n, 1]`.
fn row(column: &Tensor) -> candle_core::Result<Strips> {
    let mut row = Strips::new(1, column.elem_count());
    row.set_row(0, &column.flatten_all()?.to_vec1()?);
    Ok(row)
}

/// Adds TD3's noise to target actions, inside the box.
fn smooth(actions: &mut Strips, config: &Config, rng: &mut impl Rng) {
    let noise = smoothing(config, actions.rows() * actions.columns(), rng);
    for row in 0..actions.rows() {
        let of_row = noise.iter().skip(row).step_by(actions.rows());
        let mut moved = actions.row(row);
        moved.iter_mut().zip(of_row).for_each(|(action, noise)| *action = (*action + noise).clamp(-1.0, 1.0));
        actions.set_row(row, &moved);
    }
}

/// Refuses a memory of other spaces, or one without anything in it.
pub(super) fn check(replay: &Replay, dims: Dims) -> Result<(), Error> {
    if replay.is_empty() {
        return Err(Error::EmptyReplay);
    }
    for (what, found, expected) in
        [("observations", replay.observation_dim(), dims.observation), ("actions", replay.action_dim(), dims.action)]
    {
        if found != expected {
            return Err(Error::Dims { what, found, expected });
        }
    }
    Ok(())
}

/// Clipped Gaussian noise on target actions.
pub(super) fn smoothing(config: &Config, count: usize, rng: &mut impl Rng) -> Vec<f32> {
    let (sigma, clip) = (config.smoothing_sigma as f32, config.smoothing_clip as f32);
    (0..count).map(|_| (sigma * rng.sample::<f32, _>(StandardNormal)).clamp(-clip, clip)).collect()
}

/// What one critic says about a minibatch.
struct Judged {
    loss: f32,
    mean_value: f32,
    /// Length of its gradient.
    norm: f32,
    /// y − Q(s, a), if replay is prioritised.
    errors: Vec<f32>,
}

impl Findings {
    fn is_finite(&self) -> bool {
        let Update { critic_loss, actor_loss, mean_value, .. } = self.update;
        let norms = self.critics.iter().chain(&self.actor).copied();
        [critic_loss, actor_loss.unwrap_or(0.0), mean_value].into_iter().chain(norms).all(f32::is_finite)
    }
}
