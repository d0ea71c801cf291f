//! `Work`: one stream an actor; its messages are checked here and become commands, notices become messages.

use super::Context;
use crate::trainer::command::{Command, Newcomer, Notice};
use herd_common::spaces::Dims;
use herd_common::{caps, hash};
use herd_proto::v1::actor_message::Message as FromActor;
use herd_proto::v1::learner_message::Message as ToActor;
use herd_proto::v1::{self, work_server::Work as WorkRpc};
use herd_proto::{PROTOCOL, WireError, convert};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::{CancellationToken, DropGuard};
use tonic::{Request, Response, Status, Streaming};

/// See the .proto file.
pub(super) struct Service(pub(super) Context);

#[tonic::async_trait]
impl WorkRpc for Service {
    type JoinStream = ReceiverStream<Result<v1::LearnerMessage, Status>>;

    async fn join(&self, request: Request<Streaming<v1::ActorMessage>>) -> Result<Response<Self::JoinStream>, Status> {
        let mut inbound = request.into_inner();
        let hello = first_message(&mut inbound).await?;
        let newcomer = self.check(&hello)?;
        let (outbox, notices) = mpsc::channel(caps::ACTOR_QUEUE);
        let over = CancellationToken::new();
        let actor = self.0.trainer.ask(|reply| Command::Join { newcomer, outbox, reply }).await?;
        let actor = actor.map_err(|full| Status::resource_exhausted(full.to_string()))?;
        let (sender, receiver) = mpsc::channel(caps::ACTOR_QUEUE);
        let _ = sender.send(Ok(message(ToActor::Welcome(self.welcome(actor))))).await;
        tokio::spawn(forward_notices(notices, sender, self.0.clone(), over.clone().drop_guard()));
        tokio::spawn(receive(inbound, actor, over, self.0.clone()));
        Ok(Response::new(ReceiverStream::new(receiver)))
    }
}

impl Service {
    /// Refuses who speaks another protocol or wants another task, naming both sides.
    fn check(&self, hello: &v1::Hello) -> Result<Newcomer, Status> {
        let (build, task) = (env!("CARGO_PKG_VERSION"), &self.0.config.task);
        if hello.protocol != PROTOCOL {
            let (theirs, ours) = (hello.protocol, PROTOCOL);
            return Err(Status::failed_precondition(format!(
                "protocol mismatch: actor {} speaks protocol {theirs}, learner {build} expects {ours}",
                hello.build
            )));
        }
        let expected = self.0.config.task_hash();
        if !hello.task_hash.is_empty() && hello.task_hash != expected {
            return Err(Status::failed_precondition(format!(
                "task mismatch: actor {} wants task {} ({}), learner {build} trains {} ({})",
                hello.build,
                hello.task,
                hash::short(&hello.task_hash),
                task.kind.name(),
                hash::short(&expected)
            )));
        }
        if hello.robots == 0 || hello.robots > caps::ROBOTS_PER_ACTOR {
            let expected = format!("1 to {}", caps::ROBOTS_PER_ACTOR);
            return Err(WireError::invalid("robots", hello.robots, expected).into());
        }
        let host = convert::hello_name("host", &hello.host)?;
        Ok(Newcomer { host, pid: hello.pid, robots: hello.robots })
    }

    fn welcome(&self, actor_id: u64) -> v1::Welcome {
        v1::Welcome {
            run: self.0.config.run_name(),
            epoch: self.0.epoch,
            build: env!("CARGO_PKG_VERSION").to_owned(),
            task_hash: self.0.config.task_hash(),
            config: self.0.config.to_toml(),
            actor_id,
        }
    }
}

async fn first_message(inbound: &mut Streaming<v1::ActorMessage>) -> Result<v1::Hello, Status> {
    let first = tokio::time::timeout(caps::HANDSHAKE_TIMEOUT, inbound.message())
        .await
        .map_err(|_| Status::deadline_exceeded("no Hello arrived in time"))??;
    match first.and_then(|first| first.message) {
        Some(FromActor::Hello(hello)) => Ok(hello),
        _ => Err(Status::invalid_argument("the first message is not Hello")),
    }
}

/// Sends the trainer's notices until the trainer drops the actor, the actor leaves or the learner stops.
async fn forward_notices(
    mut notices: mpsc::Receiver<Notice>,
    sender: mpsc::Sender<Result<v1::LearnerMessage, Status>>,
    context: Context,
    _over: DropGuard,
) {
    loop {
        let notice = tokio::select! {
            notice = notices.recv() => notice,
            () = sender.closed() => return,
            () = context.shutdown.cancelled() => None,
        };
        let Some(notice) = notice else {
            let _ = sender.send(Err(Status::unavailable("the learner ended this stream, join again"))).await;
            return;
        };
        let last = notice == Notice::RunComplete;
        if sender.send(Ok(message(notice_to_wire(notice)))).await.is_err() || last {
            return;
        }
    }
}

/// Reads an actor's messages until its stream ends; a bad one is refused by name and the stream goes on.
async fn receive(mut inbound: Streaming<v1::ActorMessage>, actor: u64, over: CancellationToken, context: Context) {
    let mut refusals = 0;
    let dims = context.config.task.kind.dims();
    loop {
        let next = tokio::select! {
            next = tokio::time::timeout(caps::ACTOR_SILENCE, inbound.message()) => next,
            // The trainer dropped this actor, or it hung up.
            () = over.cancelled() => break,
            () = context.shutdown.cancelled() => break,
        };
        let Ok(Ok(Some(v1::ActorMessage { message: Some(message) }))) = next else { break };
        let command = to_command(actor, message, dims).unwrap_or_else(|refusal| {
            tracing::warn!(actor, work = %refusal.0, reason = refusal.2, "refused a message");
            refusals += 1;
            Command::Reject { actor, work: refusal.0, attempt: refusal.1, reason: refusal.2 }
        });
        if refusals > caps::REFUSALS_PER_ACTOR || context.trainer.send(command).await.is_err() {
            break;
        }
    }
    let _ = context.trainer.send(Command::Leave { actor }).await;
}

/// The work, attempt and reason of a message that breaks the contract.
type Refusal = (herd_common::work::Work, u32, String);

fn to_command(actor: u64, message: FromActor, dims: Dims) -> Result<Command, Refusal> {
    use herd_common::work::Work;
    let about = |work: Option<&v1::WorkItem>, attempt: u32| {
        let work = convert::work_from_wire(work);
        work.map_err(|error| (Work::Episode(u64::MAX), attempt, error.to_string())).map(|work| (work, attempt))
    };
    match message {
        FromActor::Transitions(piece) => {
            let (work, attempt) = about(piece.work.as_ref(), piece.attempt)?;
            let batch = convert::transitions_from_wire(&piece, dims);
            let batch = batch.map_err(|error| (work, attempt, error.to_string()))?;
            Ok(Command::Transitions { actor, work, attempt, first: piece.first, batch })
        }
        FromActor::Finished(finished) => {
            let (work, attempt) = about(finished.work.as_ref(), finished.attempt)?;
            let outcome = finished.outcome.as_ref().ok_or(WireError::Missing("outcome"));
            let outcome = outcome.and_then(TryInto::try_into).map_err(|error| (work, attempt, error.to_string()))?;
            Ok(Command::Finished { actor, work, attempt, outcome })
        }
        FromActor::Heartbeat(beat) => Ok(Command::Heartbeat { actor, beat: beat.into() }),
        FromActor::Hello(_) => Err((Work::Episode(u64::MAX), 0, "a second Hello on one stream".to_owned())),
    }
}

fn message(message: ToActor) -> v1::LearnerMessage {
    v1::LearnerMessage { message: Some(message) }
}

fn notice_to_wire(notice: Notice) -> ToActor {
    match notice {
        Notice::Lease(order) => ToActor::Lease(order.into()),
        Notice::Refused { work, attempt, reason } => {
            ToActor::Refused(v1::Refused { work: Some(work.into()), attempt, reason })
        }
        Notice::Committed(episode) => ToActor::Committed(v1::Committed { episode }),
        Notice::RunComplete => ToActor::RunComplete(v1::RunComplete {}),
    }
}
