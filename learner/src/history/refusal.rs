//! Why a message about a lease is refused, told with both sides: what was claimed and what the ledger holds.

use super::lease::Claim;
use herd_common::spaces::Dims;
use herd_common::{caps, transition};

/// A message that changed nothing.
#[derive(Debug, PartialEq, thiserror::Error)]
#[error("{claim}: {reason}")]
pub struct Refusal {
    /// What was claimed.
    pub claim: Claim,
    /// What is wrong with it.
    pub reason: Reason,
}

/// What is wrong with a message.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum Reason {
    /// Nobody was ever given this work, or it is no longer of interest.
    #[error("this work was not leased")]
    Unknown,
    /// The work is done and part of the run.
    #[error("already committed")]
    Committed,
    /// The work is done and waits for its turn.
    #[error("already finished by attempt {by_attempt}, waits to be committed")]
    Finished {
        /// The attempt that finished it.
        by_attempt: u32,
    },
    /// The lease was taken away and nobody holds it now.
    #[error("the lease was taken back after attempt {last_attempt}, nobody holds it")]
    TakenBack {
        /// The newest attempt, which ended.
        last_attempt: u32,
    },
    /// Somebody else holds the lease, or the same actor in a later attempt.
    #[error("stale, actor {holder} holds the lease as attempt {holder_attempt}")]
    Stale {
        /// The actor that holds it.
        holder: u64,
        /// Its attempt.
        holder_attempt: u32,
    },
    /// Transitions are missing or repeated.
    #[error("transitions start at {found}, expected {expected}")]
    Gap {
        /// The number that comes next.
        expected: u64,
        /// The number that came.
        found: u64,
    },
    /// More transitions than an episode may have.
    #[error("{found} transitions, expected at most {most}", most = caps::TRANSITIONS_PER_EPISODE)]
    TooMany {
        /// Transitions with those of this message.
        found: u64,
    },
    /// An evaluation brought transitions.
    #[error("{found} transitions, expected none in an evaluation")]
    Evaluation {
        /// Transitions in the message.
        found: u64,
    },
    /// Observations or actions of another task.
    #[error(
        "observations and actions have {} and {} numbers, expected {} and {}",
        found.observation, found.action, expected.observation, expected.action
    )]
    Dims {
        /// Lengths in the message.
        found: Dims,
        /// Lengths in this task.
        expected: Dims,
    },
    /// Transitions whose shapes or numbers are wrong.
    #[error(transparent)]
    Transitions(#[from] transition::Error),
    /// The outcome does not belong to the transitions.
    #[error("outcome counts {decisions} decisions, expected {staged}, the number of transitions that arrived")]
    Count {
        /// Decisions by the outcome.
        decisions: u64,
        /// Transitions that arrived.
        staged: u64,
    },
    /// An episode without a decision that did not diverge.
    #[error("outcome {ending} without a decision, expected at least one unless the simulation diverged")]
    Empty {
        /// Name of its ending.
        ending: &'static str,
    },
    /// An outcome that no episode can have.
    #[error("outcome has {field} = {value}, which no episode can have")]
    Outcome {
        /// Which field.
        field: &'static str,
        /// Its value.
        value: f64,
    },
}
