//! An actor written from the .proto file alone, that says whatever a test wants it to say.

use herd_common::spaces::{GAIT_ACTION_DIM, OBSERVATION_DIM, Task};
use herd_common::transition::{Batch, Transition};
use herd_proto::client::Client;
use herd_proto::v1::{self, actor_message::Message as Said, learner_message::Message as Heard};
use herd_proto::{PROTOCOL, convert};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Status, Streaming};

/// Longest wait for one message.
const ANSWER: Duration = Duration::from_secs(20);

/// An open `Work` stream.
#[derive(Debug)]
pub struct Raw {
    outgoing: mpsc::Sender<v1::ActorMessage>,
    incoming: Streaming<v1::LearnerMessage>,
    /// What the learner answered to Hello.
    pub welcome: v1::Welcome,
}

/// A Hello that a learner takes.
pub fn hello() -> v1::Hello {
    v1::Hello {
        protocol: PROTOCOL,
        build: "test".into(),
        host: "test-host".into(),
        pid: std::process::id(),
        robots: 1,
        ..Default::default()
    }
}

/// `count` valid transitions of a lease, starting at `first`.
pub fn piece(lease: &v1::Lease, first: u64, count: usize) -> v1::Transitions {
    let work = convert::work_from_wire(lease.work.as_ref()).expect("a lease names its work");
    let mut batch = Batch::new(Task::Gait.dims());
    for index in 0..count {
        let value = (first as f32 + index as f32) / 1000.0;
        batch.push(Transition {
            observation: &[value; OBSERVATION_DIM],
            action: &[value; GAIT_ACTION_DIM],
            reward: 1.0,
            discount: 0.95,
            next_observation: &[value; OBSERVATION_DIM],
        });
    }
    convert::transitions_to_wire(work, lease.attempt, first, &batch)
}

/// The end of a lease after this many transitions.
pub fn finished(lease: &v1::Lease, decisions: u64) -> v1::Finished {
    let outcome = v1::Outcome { ending: "timed_out".into(), decisions, seconds: 1.0, ..Default::default() };
    v1::Finished { work: lease.work, attempt: lease.attempt, outcome: Some(outcome) }
}

impl Raw {
    /// Says `hello` to the learner at `address`.
    pub async fn join(address: &str, hello: v1::Hello) -> Result<Self, Status> {
        Self::begin(address, Said::Hello(hello)).await
    }

    /// Opens a stream with any first message.
    pub async fn begin(address: &str, first: Said) -> Result<Self, Status> {
        let client = Client::connect(address).await.expect("the learner listens");
        let (outgoing, messages) = mpsc::channel(64);
        let first = v1::ActorMessage { message: Some(first) };
        outgoing.send(first).await.expect("the queue is new");
        let mut incoming = client.work().join(ReceiverStream::new(messages)).await?.into_inner();
        match next(&mut incoming).await? {
            Some(Heard::Welcome(welcome)) => Ok(Self { outgoing, incoming, welcome }),
            other => panic!("expected Welcome, got {other:?}"),
        }
    }

    /// Says something.
    pub async fn say(&self, message: Said) {
        self.outgoing.send(v1::ActorMessage { message: Some(message) }).await.expect("the stream is open");
    }

    /// Says something, unless the stream is already over.
    pub async fn try_say(&self, message: Said) {
        let _ = self.outgoing.send(v1::ActorMessage { message: Some(message) }).await;
    }

    /// What the learner says next; an error or `None` when it ends the stream.
    pub async fn hear(&mut self) -> Result<Option<Heard>, Status> {
        next(&mut self.incoming).await
    }

    /// The next lease of an episode of the run, other messages passed over.
    pub async fn lease(&mut self) -> v1::Lease {
        loop {
            match self.hear().await.expect("the stream goes on") {
                Some(Heard::Lease(lease)) if lease.sigma > 0.0 => return lease,
                Some(_) => {}
                None => panic!("the stream ended, expected a lease"),
            }
        }
    }

    /// The next refusal, other messages passed over.
    pub async fn refusal(&mut self) -> v1::Refused {
        loop {
            match self.hear().await.expect("the stream goes on") {
                Some(Heard::Refused(refused)) => return refused,
                Some(_) => {}
                None => panic!("the stream ended, expected a refusal"),
            }
        }
    }
}

async fn next(incoming: &mut Streaming<v1::LearnerMessage>) -> Result<Option<Heard>, Status> {
    let message = tokio::time::timeout(ANSWER, incoming.message());
    let message = message.await.map_err(|_| Status::deadline_exceeded("the test waited long enough"))?;
    Ok(message?.and_then(|message| message.message))
}
