//! The learner that the configuration asks for: the CPU's trainer, or the one on a device.

use super::device::{self, OnDevice};
use super::error::Error;
use super::snapshot::Snapshot;
use super::update::{Ddpg, Update};
use crate::replay::Replay;
use herd_common::config::ddpg::{Config, Device};
use herd_common::policy::Layer;
use herd_common::seed::Seed;
use herd_common::spaces::Dims;

/// A learner. Snapshots pass between the two kinds.
#[derive(Debug)]
pub enum Learner {
    /// In place on the calling thread.
    Cpu(Box<Ddpg>),
    /// On a GPU, several updates at a time.
    Device(Box<OnDevice>),
}

impl Learner {
    /// Fresh networks where `ddpg.device` says; every random number descends from `seed`.
    pub fn new(config: &Config, dims: Dims, seed: Seed) -> Result<Self, Error> {
        Ok(match config.device {
            Device::Cpu => Self::Cpu(Box::new(Ddpg::new(config, dims, seed)?)),
            Device::Cuda => Self::Device(Box::new(OnDevice::new(config, dims, seed, device::Device::Cuda)?)),
        })
    }

    /// Fails if this program or machine cannot compute such networks where `ddpg.device` says.
    pub fn check(config: &Config, dims: Dims) -> Result<(), Error> {
        match config.device {
            Device::Cpu => Ok(()),
            Device::Cuda => OnDevice::check(config, dims, device::Device::Cuda),
        }
    }

    /// Updates so far, skipped ones included.
    pub fn updates(&self) -> u64 {
        match self {
            Self::Cpu(ddpg) => ddpg.updates(),
            Self::Device(ddpg) => ddpg.updates(),
        }
    }

    /// Updates skipped so far.
    pub fn skipped(&self) -> u64 {
        match self {
            Self::Cpu(ddpg) => ddpg.skipped(),
            Self::Device(ddpg) => ddpg.skipped(),
        }
    }

    /// Learns from at least one and at most `most` minibatches: one on the CPU, as many as go together on a device.
    pub fn learn(&mut self, replay: &Replay, most: u64) -> Result<Vec<Update>, Error> {
        match self {
            Self::Cpu(ddpg) => Ok(vec![ddpg.update(replay)?]),
            Self::Device(ddpg) => ddpg.learn(replay, most),
        }
    }

    /// All that the next update depends on, but for configuration, seed and replay memory.
    pub fn save(&self) -> Result<Snapshot, Error> {
        match self {
            Self::Cpu(ddpg) => ddpg.save(),
            Self::Device(ddpg) => ddpg.save(),
        }
    }

    /// Goes on where `snapshot` was taken.
    pub fn load(&mut self, snapshot: &Snapshot) -> Result<(), Error> {
        match self {
            Self::Cpu(ddpg) => ddpg.load(snapshot),
            Self::Device(ddpg) => ddpg.load(snapshot),
        }
    }

    /// The actor as plain data, every number finite.
    pub fn policy_layers(&self) -> Result<Vec<Layer>, Error> {
        match self {
            Self::Cpu(ddpg) => ddpg.policy_layers(),
            Self::Device(ddpg) => ddpg.policy_layers(),
        }
    }
}
