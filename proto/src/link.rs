//! The actor's end of `Work.Join` and the stream of status, in domain types.

use crate::client::{Client, Error};
use crate::packed::Packed;
use crate::{PROTOCOL, WireError, convert, v1};
use herd_common::caps;
use herd_common::episode::Outcome;
use herd_common::status::{Heartbeat, Status};
use herd_common::transition::Batch;
use herd_common::work::{Order, Work};
use tokio::sync::mpsc;
use tonic::Streaming;
use v1::actor_message::Message as Up;
use v1::learner_message::Message as Down;

/// Who joins; protocol and build are filled in here.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hello {
    /// Hash of the task the actor insists on; empty takes the learner's.
    pub task_hash: String,
    /// What that task is in words.
    pub task: String,
    /// Host name.
    pub host: String,
    /// Process.
    pub pid: u32,
    /// Episodes it can run at once.
    pub robots: u32,
}

/// What the actor joins.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Welcome {
    /// Content name of the run.
    pub run: String,
    /// How often a learner has been started on it.
    pub epoch: u64,
    /// The learner's build.
    pub build: String,
    /// Hash of the task as the learner understands it.
    pub task_hash: String,
    /// The complete configuration as TOML.
    pub config: String,
    /// The number given to this actor.
    pub actor_id: u64,
}

/// What an actor says.
#[derive(Clone, Debug, PartialEq)]
pub enum Report {
    /// The next piece of a leased episode.
    Transitions {
        /// Which episode.
        work: Work,
        /// Which lease of it.
        attempt: u32,
        /// Index within the episode of the first transition here.
        first: u64,
        /// The transitions.
        batch: Batch,
    },
    /// The same, packed beforehand.
    Packed {
        /// Which episode.
        work: Work,
        /// Which lease of it.
        attempt: u32,
        /// Index within the episode of the first transition here.
        first: u64,
        /// The transitions.
        piece: Packed,
    },
    /// The end of a leased episode.
    Finished {
        /// Which episode.
        work: Work,
        /// Which lease of it.
        attempt: u32,
        /// Its summary.
        outcome: Outcome,
    },
    /// Counters.
    Heartbeat(Heartbeat),
}

/// What a learner says.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// Run this.
    Lease(Order),
    /// Drop this episode.
    Refused {
        /// Which episode.
        work: Work,
        /// Which lease of it.
        attempt: u32,
        /// Why.
        reason: String,
    },
    /// An episode is part of the run.
    Committed(u64),
    /// The run has all its episodes.
    RunComplete,
}

/// The sending half of a joined stream; dropping it ends the stream.
#[derive(Debug)]
pub struct Sender(mpsc::Sender<v1::ActorMessage>);

/// Room for one report.
#[derive(Debug)]
pub struct Permit<'a>(mpsc::Permit<'a, v1::ActorMessage>);

/// The receiving half of a joined stream.
#[derive(Debug)]
pub struct Receiver(Streaming<v1::LearnerMessage>);

/// Status snapshots.
#[derive(Debug)]
pub struct StatusStream(Streaming<v1::Status>);

impl Client {
    /// Joins the run; the learner's `Welcome` comes with both halves of the stream.
    pub async fn join(&self, hello: Hello) -> Result<(Welcome, Sender, Receiver), Error> {
        let (sender, reports) = mpsc::channel(REPORTS_QUEUED);
        let first = v1::ActorMessage { message: Some(Up::Hello(hello.into())) };
        sender.try_send(first).expect("a new queue has room");
        let handshake = async {
            let reports = tokio_stream::wrappers::ReceiverStream::new(reports);
            let mut answers = self.work().join(reports).await?.into_inner();
            match answers.message().await?.and_then(|answer| answer.message) {
                Some(Down::Welcome(welcome)) => Ok((welcome.into(), Sender(sender), Receiver(answers))),
                _ => Err(WireError::Missing("welcome").into()),
            }
        };
        let silent = |_| tonic::Status::deadline_exceeded("no answer to the handshake");
        tokio::time::timeout(caps::CALL_TIMEOUT, handshake).await.map_err(silent)?
    }

    /// A snapshot every `period_secs` until the run ends.
    pub async fn watch_status(&self, period_secs: f64) -> Result<StatusStream, Error> {
        let request = v1::WatchStatusRequest { period_secs };
        Ok(StatusStream(self.training().watch_status(request).await?.into_inner()))
    }
}

/// Reports waiting for the network; beyond it the sender waits.
const REPORTS_QUEUED: usize = 16;

impl Sender {
    /// Waits for room; `None` when the stream is closed. Safe to drop while it waits.
    pub async fn reserve(&self) -> Option<Permit<'_>> {
        self.0.reserve().await.ok().map(Permit)
    }

    /// Sends if there is room now.
    pub fn try_send(&self, report: Report) -> bool {
        self.0.try_send(report.into()).is_ok()
    }
}

impl Permit<'_> {
    /// Sends into the room held.
    pub fn send(self, report: Report) {
        self.0.send(report.into());
    }
}

impl Receiver {
    /// The next answer; `None` at the end of the stream. Safe to drop while it waits.
    pub async fn next(&mut self) -> Result<Option<Answer>, Error> {
        self.0.message().await?.map(|answer| Ok(Answer::try_from(answer)?)).transpose()
    }
}

impl StatusStream {
    /// The next snapshot; `None` at the end of the stream. Safe to drop while it waits.
    pub async fn next(&mut self) -> Result<Option<Status>, Error> {
        Ok(self.0.message().await?.map(Into::into))
    }
}

impl From<Hello> for v1::Hello {
    fn from(hello: Hello) -> Self {
        Self {
            protocol: PROTOCOL,
            build: crate::BUILD.into(),
            task_hash: hello.task_hash,
            task: hello.task,
            host: hello.host,
            pid: hello.pid,
            robots: hello.robots,
        }
    }
}

impl From<v1::Welcome> for Welcome {
    fn from(welcome: v1::Welcome) -> Self {
        Self {
            run: welcome.run,
            epoch: welcome.epoch,
            build: welcome.build,
            task_hash: welcome.task_hash,
            config: welcome.config,
            actor_id: welcome.actor_id,
        }
    }
}

impl From<Report> for v1::ActorMessage {
    fn from(report: Report) -> Self {
        let message = match report {
            Report::Transitions { work, attempt, first, batch } => {
                Up::Transitions(convert::transitions_to_wire(work, attempt, first, &batch))
            }
            Report::Packed { work, attempt, first, piece } => Up::Transitions(piece.addressed(work, attempt, first)),
            Report::Finished { work, attempt, outcome } => {
                Up::Finished(v1::Finished { work: Some(work.into()), attempt, outcome: Some((&outcome).into()) })
            }
            Report::Heartbeat(beat) => Up::Heartbeat(beat.into()),
        };
        Self { message: Some(message) }
    }
}

impl TryFrom<v1::LearnerMessage> for Answer {
    type Error = WireError;

    fn try_from(answer: v1::LearnerMessage) -> Result<Self, WireError> {
        Ok(match answer.message {
            Some(Down::Lease(lease)) => Self::Lease(lease.try_into()?),
            Some(Down::Refused(refused)) => Self::Refused {
                work: convert::work_from_wire(refused.work.as_ref())?,
                attempt: refused.attempt,
                reason: refused.reason,
            },
            Some(Down::Committed(committed)) => Self::Committed(committed.episode),
            Some(Down::RunComplete(_)) => Self::RunComplete,
            Some(Down::Welcome(_)) => return Err(WireError::invalid("answer", "a second welcome", "one")),
            None => return Err(WireError::Missing("message")),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::seed::Seed;

    #[test]
    fn answers_come_back() {
        let seed = Seed::from_number(4);
        let order = Order { work: Work::Episode(3), attempt: 1, seed, policy_version: 7, sigma: 0.25, random: false };
        let wire = v1::LearnerMessage { message: Some(Down::Lease(order.into())) };
        assert_eq!(Answer::try_from(wire).expect("valid"), Answer::Lease(order));
        let refused = v1::Refused { work: Some(order.work.into()), attempt: 1, reason: "late".into() };
        let wire = v1::LearnerMessage { message: Some(Down::Refused(refused)) };
        let expected = Answer::Refused { work: order.work, attempt: 1, reason: "late".into() };
        assert_eq!(Answer::try_from(wire).expect("valid"), expected);
        assert!(Answer::try_from(v1::LearnerMessage { message: None }).is_err());
    }
}
