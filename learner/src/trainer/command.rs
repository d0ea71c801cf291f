//! What the rest of the process may ask of the trainer thread; the only way to reach its state.

use herd_common::caps;
use herd_common::episode::Outcome;
use herd_common::status::{Heartbeat, Status};
use herd_common::transition::Batch;
use herd_common::work::{Order, Work};
use tokio::sync::{mpsc, oneshot};

/// A request to the trainer, already checked at the wire.
#[derive(Debug)]
pub enum Command {
    /// An actor joins; notices for it go to `outbox`, whose other end its stream drains.
    Join {
        /// Who.
        newcomer: Newcomer,
        /// Where its notices go.
        outbox: mpsc::Sender<Notice>,
        /// Its number, or why it may not join.
        reply: oneshot::Sender<Result<u64, Full>>,
    },
    /// A piece of an episode.
    Transitions {
        /// Sender.
        actor: u64,
        /// Of what.
        work: Work,
        /// Under which lease.
        attempt: u32,
        /// Index of its first transition.
        first: u64,
        /// The piece.
        batch: Batch,
    },
    /// The end of an episode.
    Finished {
        /// Sender.
        actor: u64,
        /// Of what.
        work: Work,
        /// Under which lease.
        attempt: u32,
        /// How it went.
        outcome: Outcome,
    },
    /// The wire refused a message about an episode: its lease is void.
    Reject {
        /// Sender.
        actor: u64,
        /// Of what.
        work: Work,
        /// Under which lease.
        attempt: u32,
        /// What was wrong.
        reason: String,
    },
    /// Measured figures of an actor.
    Heartbeat {
        /// Sender.
        actor: u64,
        /// The figures.
        beat: Heartbeat,
    },
    /// An actor's stream is over.
    Leave {
        /// Who left.
        actor: u64,
    },
    /// How is it going?
    Status(oneshot::Sender<Status>),
    /// Write a checkpoint now; answers with its episodes and file name.
    Checkpoint(oneshot::Sender<Result<(u64, String), String>>),
    /// Write a checkpoint and end; answers with the episodes committed.
    Stop(Option<oneshot::Sender<u64>>),
}

/// An actor that asks to join.
#[derive(Clone, Debug)]
pub struct Newcomer {
    /// Its host.
    pub host: String,
    /// Its process.
    pub pid: u32,
    /// Episodes it can run at once.
    pub robots: u32,
}

/// There is no room for another actor.
#[derive(Debug, thiserror::Error)]
#[error("{} actors are connected, the most there may be", caps::ACTORS)]
pub struct Full;

/// What the trainer tells an actor.
#[derive(Clone, Debug, PartialEq)]
pub enum Notice {
    /// Run this.
    Lease(Order),
    /// That was not taken; drop it.
    Refused {
        /// What.
        work: Work,
        /// Under which lease.
        attempt: u32,
        /// Why.
        reason: String,
    },
    /// That is part of the run.
    Committed(u64),
    /// The run has all its episodes.
    RunComplete,
}

/// The trainer's door: cloneable, bounded; senders wait when the trainer is busy.
#[derive(Clone, Debug)]
pub struct Handle(mpsc::Sender<Command>);

/// The trainer thread has ended.
#[derive(Debug, thiserror::Error)]
#[error("the learner is stopping")]
pub struct Gone;

impl Handle {
    /// A door and the queue behind it.
    pub fn new() -> (Self, mpsc::Receiver<Command>) {
        let (sender, receiver) = mpsc::channel(caps::TRAINER_QUEUE);
        (Self(sender), receiver)
    }

    /// Passes a command on, waiting for room.
    pub async fn send(&self, command: Command) -> Result<(), Gone> {
        self.0.send(command).await.map_err(|_| Gone)
    }

    /// Passes a command on and waits for its answer.
    pub async fn ask<T>(&self, command: impl FnOnce(oneshot::Sender<T>) -> Command) -> Result<T, Gone> {
        let (reply, answer) = oneshot::channel();
        self.send(command(reply)).await?;
        answer.await.map_err(|_| Gone)
    }
}
