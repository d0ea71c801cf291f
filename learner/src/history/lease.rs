//! Work, and who holds it: the words in which learner and actors speak of leases.

use herd_common::caps;

/// Something an actor can be asked to run. Sorted by urgency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Work {
    /// The training episode of this number.
    Episode(u64),
    /// One evaluation episode: no noise, nothing learnt from it.
    Evaluation {
        /// The policy on trial.
        version: u64,
        /// Which of the evaluation's episodes, from 0.
        index: u64,
    },
}

impl std::fmt::Display for Work {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Episode(episode) => write!(f, "episode {episode}"),
            Self::Evaluation { version, index } => write!(f, "evaluation {index} of version {version}"),
        }
    }
}

/// The right and duty to run something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lease {
    /// What to run.
    pub work: Work,
    /// How often it has been leased by this learner, this lease included.
    pub attempt: u32,
    /// The policy to use.
    pub version: u64,
    /// Standard deviation of the exploration noise, in units of the action box's half width.
    pub sigma: f32,
}

impl Work {
    /// Sorts after every episode and before every other evaluation.
    pub(super) const FIRST_EVALUATION: Self = Self::Evaluation { version: 0, index: 0 };
}

/// What an actor says its message belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Claim {
    /// The actor that speaks.
    pub actor: u64,
    /// The work it reports on.
    pub work: Work,
    /// The attempt it was given with the lease.
    pub attempt: u32,
}

impl std::fmt::Display for Claim {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "actor {}, attempt {} of {}", self.actor, self.attempt, self.work)
    }
}

/// An episode that no actor brings to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{work} was leased {leases} times without being finished, expected at most {most}", most = caps::LEASES_PER_EPISODE)]
pub struct Exhausted {
    /// The work at fault.
    pub work: Work,
    /// How often it was leased.
    pub leases: u32,
}
