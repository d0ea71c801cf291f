//! A learner without learning: leases what the test says, checks what comes back.

use super::policy;
use herd_common::config::Config;
use herd_common::spaces::Task;
use herd_common::work::{Order, Work};
use herd_proto::{convert, v1};
use std::collections::{BTreeMap, VecDeque};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard};
use tokio::sync::mpsc;
use tokio_stream::{Stream, StreamExt};
use tonic::{Request, Response, Status, Streaming};
use v1::actor_message::Message as Up;
use v1::learner_message::Message as Down;

/// What the learner does.
#[derive(Clone, Debug, Default)]
pub(crate) struct Script {
    /// Leases to give, in order.
    pub(crate) leases: VecDeque<Order>,
    /// Refuses the handshake with this.
    pub(crate) refuses: Option<Status>,
    /// Claims this task hash.
    pub(crate) task_hash: Option<String>,
    /// Breaks the first stream after this many messages of episodes.
    pub(crate) breaks_after: Option<usize>,
    /// Refuses the lease of this work as soon as it is given.
    pub(crate) drops: Option<Work>,
}

/// What the learner saw.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    /// Handshakes.
    pub(crate) hellos: Vec<v1::Hello>,
    /// Transitions of each episode that was finished.
    pub(crate) finished: BTreeMap<Work, u64>,
    /// Policies fetched one by one.
    pub(crate) fetched: Vec<u64>,
}

/// A learner that follows its script.
#[derive(Clone, Debug, Default)]
pub(crate) struct Learner {
    state: Arc<Mutex<(Script, Seen)>>,
}

type Answers = Pin<Box<dyn Stream<Item = Result<v1::LearnerMessage, Status>> + Send>>;

impl Learner {
    pub(crate) fn new(script: Script) -> Self {
        Self { state: Arc::new(Mutex::new((script, Seen::default()))) }
    }

    pub(crate) fn seen(&self) -> Seen {
        self.state().1.clone()
    }

    /// Serves on a free port of this machine, for as long as the runtime lives; gives the address.
    pub(crate) async fn serve(&self) -> String {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("bound").to_string();
        let server = tonic::transport::Server::builder()
            .add_service(v1::work_server::WorkServer::new(self.clone()))
            .add_service(v1::policies_server::PoliciesServer::new(self.clone()));
        tokio::spawn(server.serve_with_incoming(tokio_stream::wrappers::TcpListenerStream::new(listener)));
        address
    }

    fn state(&self) -> MutexGuard<'_, (Script, Seen)> {
        self.state.lock().expect("no test panics with it")
    }

    fn welcome(&self) -> Down {
        let config = Config::default();
        let task_hash = self.state().0.task_hash.clone().unwrap_or_else(|| config.task_hash());
        let (run, build) = ("run".to_owned(), "test".to_owned());
        Down::Welcome(v1::Welcome { run, epoch: 1, build, task_hash, config: config.to_toml(), actor_id: 1 })
    }

    /// One stream; leases that are open when it breaks go back to the front.
    async fn converse(&self, mut reports: Streaming<v1::ActorMessage>, robots: u32, first: bool, out: Out) {
        let breaks_after = self.state().0.breaks_after.filter(|_| first);
        let mut open: BTreeMap<Work, (Order, u64)> = BTreeMap::new();
        out.say(self.welcome());
        let mut heard = 0;
        loop {
            while open.len() < robots as usize {
                let Some(order) = self.state().0.leases.pop_front() else { break };
                out.say(Down::Lease(order.into()));
                if self.state().0.drops == Some(order.work) {
                    let work = Some(order.work.into());
                    out.say(Down::Refused(v1::Refused { work, attempt: order.attempt, reason: "test".into() }));
                } else {
                    open.insert(order.work, (order, 0));
                }
            }
            if open.is_empty() {
                return out.say(Down::RunComplete(v1::RunComplete {}));
            }
            let report = reports.next().await.and_then(Result::ok).and_then(|report| report.message);
            heard += usize::from(matches!(report, Some(Up::Transitions(_) | Up::Finished(_))));
            if report.is_none() || breaks_after.is_some_and(|n| heard > n) {
                // A panicking robot would only panic again.
                let again = open.into_values().map(|(order, _)| order);
                let again = again.filter(|order| order.work != Work::Episode(super::Puppet::PANICS));
                self.state().0.leases.extend(again);
                return out.fail(Status::unavailable("broken by the test"));
            }
            self.take(report, &mut open);
        }
    }

    fn take(&self, report: Option<Up>, open: &mut BTreeMap<Work, (Order, u64)>) {
        match report {
            Some(Up::Transitions(piece)) => {
                let work = convert::work_from_wire(piece.work.as_ref()).expect("has work");
                let batch = convert::transitions_from_wire(&piece, Task::Gait.dims()).expect("valid");
                let (order, count) = open.get_mut(&work).expect("only leased episodes are sent");
                assert_eq!((piece.attempt, piece.first), (order.attempt, *count), "{work}");
                *count += batch.len() as u64;
            }
            Some(Up::Finished(end)) => {
                let work = convert::work_from_wire(end.work.as_ref()).expect("has work");
                let (_, count) = open.remove(&work).expect("only leased episodes are finished");
                assert_eq!(self.state().1.finished.insert(work, count), None, "{work} came twice");
            }
            _ => {}
        }
    }
}

/// The sending half of a stream of answers.
struct Out(mpsc::UnboundedSender<Result<v1::LearnerMessage, Status>>);

impl Out {
    fn say(&self, message: Down) {
        let _ = self.0.send(Ok(v1::LearnerMessage { message: Some(message) }));
    }

    fn fail(&self, status: Status) {
        let _ = self.0.send(Err(status));
    }
}

#[tonic::async_trait]
impl v1::work_server::Work for Learner {
    type JoinStream = Answers;

    async fn join(&self, request: Request<Streaming<v1::ActorMessage>>) -> Result<Response<Answers>, Status> {
        let mut reports = request.into_inner();
        let Some(Up::Hello(hello)) = reports.next().await.expect("a first message")?.message else {
            return Err(Status::invalid_argument("expected hello"));
        };
        if let Some(refusal) = self.state().0.refuses.clone() {
            return Err(refusal);
        }
        let (robots, first) = (hello.robots, self.state().1.hellos.is_empty());
        self.state().1.hellos.push(hello);
        let (sender, answers) = mpsc::unbounded_channel();
        let learner = self.clone();
        tokio::spawn(async move { learner.converse(reports, robots, first, Out(sender)).await });
        Ok(Response::new(Box::pin(tokio_stream::wrappers::UnboundedReceiverStream::new(answers))))
    }
}

#[tonic::async_trait]
impl v1::policies_server::Policies for Learner {
    type WatchStream = Pin<Box<dyn Stream<Item = Result<v1::Policy, Status>> + Send>>;

    async fn watch(&self, _: Request<v1::WatchPolicyRequest>) -> Result<Response<Self::WatchStream>, Status> {
        Ok(Response::new(Box::pin(tokio_stream::pending())))
    }

    async fn get(&self, request: Request<v1::GetPolicyRequest>) -> Result<Response<v1::Policy>, Status> {
        let version = request.into_inner().version;
        self.state().1.fetched.push(version);
        Ok(Response::new(convert::policy_to_wire(&policy(&Config::default(), version), None)))
    }
}
