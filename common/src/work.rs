//! The unit of work: what is leased, to be run by whom, how often already.

use crate::seed::Seed;

/// One thing to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Work {
    /// Episode e of the run.
    Episode(u64),
    /// One episode of an evaluation, without noise; never stored in replay.
    Evaluation {
        /// Policy that is evaluated.
        version: u64,
        /// Which of the fixed seeds.
        index: u64,
    },
}

impl std::fmt::Display for Work {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Episode(episode) => write!(f, "episode {episode}"),
            Self::Evaluation { version, index } => write!(f, "evaluation {index} of policy {version}"),
        }
    }
}

impl Work {
    /// Root of the episode's random numbers; evaluations of every policy share their seeds, so that they compare.
    pub fn seed(self, run: Seed) -> Seed {
        match self {
            Self::Episode(episode) => run.child("episode", episode),
            Self::Evaluation { index, .. } => run.child("evaluation", index),
        }
    }
}

/// A lease as the actor sees it: everything that the episode is a function of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Order {
    /// What to run.
    pub work: Work,
    /// Which lease of it this is.
    pub attempt: u32,
    /// Root of its random numbers.
    pub seed: Seed,
    /// Policy to act with.
    pub policy_version: u64,
    /// Standard deviation of the exploration noise.
    pub sigma: f32,
    /// Act at random instead.
    pub random: bool,
}
