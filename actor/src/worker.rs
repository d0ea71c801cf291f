//! The robot threads: each owns one robot, takes one order at a time and tells how it goes.
//!
//! A thread knows nothing of the network. It gets an order with the policy to use, sends pieces of the episode and its
//! end into the queue that came with the order, and gives up as soon as the order is cancelled or the queue is gone. A
//! robot that panics is thrown away and the next order gets a new one; the panic is told, not hidden.

use crate::meter::Meter;
use herd_common::caps;
use herd_common::config::Config;
use herd_common::episode::Outcome;
use herd_common::policy::Policy;
use herd_common::transition::Batch;
use herd_common::work::{Order, Work};
use std::any::Any;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::JoinHandle;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// Whatever can run an episode; a simulated robot, or a stand-in for one in tests.
pub trait Robot {
    /// Runs `order`, handing out the episode in pieces; `None` when `emit` broke it off.
    ///
    /// The episode is a function of the order and the policy alone.
    fn run(&mut self, order: &Order, policy: Option<&Policy>, emit: &mut Emit<'_>) -> Option<Outcome>;
}

/// Takes pieces of an episode. It may be called with an empty piece, to ask whether to go on.
pub type Emit<'a> = dyn FnMut(Batch) -> ControlFlow<()> + 'a;

/// Builds robot number so-and-so for a task; called in the robot's thread.
pub type Factory = Arc<dyn Fn(usize, &Config, Arc<Meter>) -> Box<dyn Robot> + Send + Sync>;

/// The task that an order belongs to.
#[derive(Debug)]
pub struct Task {
    /// The learner's configuration.
    pub config: Config,
    /// Its task hash: robots are rebuilt when it changes.
    pub hash: String,
}

/// An order for one robot.
#[derive(Debug)]
pub struct Assignment {
    /// What to run.
    pub order: Order,
    /// The policy to act with; none when the order is for random or constant actions.
    pub policy: Option<Arc<Policy>>,
    /// What it belongs to.
    pub task: Arc<Task>,
    /// Cancelled when nobody wants the episode any more.
    pub cancel: CancellationToken,
    /// Where its pieces go.
    pub events: mpsc::Sender<Event>,
}

/// Something a robot tells.
#[derive(Debug)]
pub struct Event {
    /// Which robot.
    pub robot: usize,
    /// The episode.
    pub work: Work,
    /// Which lease of it.
    pub attempt: u32,
    /// What happened.
    pub what: What,
}

/// What happened to an episode.
#[derive(Debug)]
pub enum What {
    /// Its next transitions.
    Piece {
        /// Index of the first.
        first: u64,
        /// The transitions.
        batch: Batch,
    },
    /// It is over.
    Finished(Outcome),
    /// It was broken off as asked.
    Dropped,
    /// The robot panicked with these words.
    Panicked(String),
}

/// The robot threads of one actor.
#[derive(Debug)]
pub struct Pool {
    robots: Vec<(std::sync::mpsc::SyncSender<Assignment>, JoinHandle<()>)>,
}

impl Pool {
    /// Starts the threads of `robots` robots.
    pub fn start(robots: u32, factory: &Factory, meter: &Arc<Meter>) -> std::io::Result<Self> {
        let robots = (0..robots as usize)
            .map(|robot| {
                let (sender, orders) = std::sync::mpsc::sync_channel(ORDERS_QUEUED);
                let (factory, meter) = (factory.clone(), meter.clone());
                let work = move || serve(robot, &orders, &factory, &meter);
                Ok((sender, std::thread::Builder::new().name(format!("robot-{robot}")).spawn(work)?))
            })
            .collect::<std::io::Result<_>>()?;
        Ok(Self { robots })
    }

    /// Gives an assignment to a robot; false when its queue is full or its thread is gone.
    pub fn assign(&self, robot: usize, assignment: Assignment) -> bool {
        self.robots[robot].0.try_send(assignment).is_ok()
    }

    /// Robots in the pool.
    pub fn len(&self) -> usize {
        self.robots.len()
    }

    /// True when there are none.
    pub fn is_empty(&self) -> bool {
        self.robots.is_empty()
    }
}

impl Drop for Pool {
    /// Waits for the threads, which end once they have no orders; cancel those first.
    fn drop(&mut self) {
        for (orders, thread) in self.robots.drain(..) {
            drop(orders);
            if thread.join().is_err() {
                tracing::error!("a robot thread ended in a panic outside of any episode");
            }
        }
    }
}

/// A robot may still be breaking off orders of broken streams when the next one comes.
const ORDERS_QUEUED: usize = 16;
/// Transitions gathered before they are sent on.
pub const PIECE: usize = 32;

fn serve(robot: usize, orders: &std::sync::mpsc::Receiver<Assignment>, factory: &Factory, meter: &Arc<Meter>) {
    let mut built: Option<(String, Box<dyn Robot>)> = None;
    while let Ok(assignment) = orders.recv() {
        // The robot is taken out while it runs, so that one that panics is not used again.
        let ready = built.take().filter(|(hash, _)| *hash == assignment.task.hash);
        let ran = catch_unwind(AssertUnwindSafe(|| {
            let (hash, mut body) = ready.unwrap_or_else(|| {
                (assignment.task.hash.clone(), factory(robot, &assignment.task.config, meter.clone()))
            });
            let what = run(robot, &assignment, body.as_mut());
            (what, (hash, body))
        }));
        let what = match ran {
            Ok((what, kept)) => {
                built = Some(kept);
                what
            }
            Err(panic) => What::Panicked(words(panic.as_ref())),
        };
        tell(robot, &assignment, what);
    }
}

fn run(robot: usize, assignment: &Assignment, body: &mut dyn Robot) -> What {
    // Of an evaluation only the outcome is wanted: nothing of it may enter replay.
    let is_evaluation = matches!(assignment.order.work, Work::Evaluation { .. });
    let mut first = 0;
    let mut emit = |batch: Batch| {
        if assignment.cancel.is_cancelled() || first + batch.len() as u64 > caps::TRANSITIONS_PER_EPISODE as u64 {
            return ControlFlow::Break(());
        }
        if batch.is_empty() || is_evaluation {
            return ControlFlow::Continue(());
        }
        let next = first + batch.len() as u64;
        let piece = What::Piece { first, batch };
        first = next;
        if tell(robot, assignment, piece) { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    };
    body.run(&assignment.order, assignment.policy.as_deref(), &mut emit).map_or(What::Dropped, What::Finished)
}

/// Blocks while the queue is full, which is how a slow network slows the robots down; false when nobody listens.
fn tell(robot: usize, assignment: &Assignment, what: What) -> bool {
    let event = Event { robot, work: assignment.order.work, attempt: assignment.order.attempt, what };
    assignment.events.blocking_send(event).is_ok()
}

fn words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no words").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Puppet, order};

    struct Fixture {
        pool: Pool,
        task: Arc<Task>,
        events: mpsc::Sender<Event>,
        told: mpsc::Receiver<Event>,
    }

    fn fixture() -> Fixture {
        let (events, told) = mpsc::channel(caps::UPLINK_QUEUE);
        let config = Config::default();
        let hash = config.task_hash();
        let pool = Pool::start(1, &Puppet::factory(), &Arc::default()).expect("starts");
        Fixture { pool, task: Arc::new(Task { config, hash }), events, told }
    }

    impl Fixture {
        fn assign(&self, episode: u64) -> CancellationToken {
            self.assign_order(order(episode))
        }

        fn assign_order(&self, order: Order) -> CancellationToken {
            let cancel = CancellationToken::new();
            let (task, events) = (self.task.clone(), self.events.clone());
            let assignment = Assignment { order, policy: None, task, cancel: cancel.clone(), events };
            assert!(self.pool.assign(0, assignment));
            cancel
        }

        /// Transitions told until the end of an episode, and its end.
        fn end(&mut self) -> (u64, What) {
            let mut count = 0;
            loop {
                match self.told.blocking_recv().expect("an event").what {
                    What::Piece { first, batch } => {
                        assert_eq!(first, count);
                        count += batch.len() as u64;
                    }
                    end => return (count, end),
                }
            }
        }
    }

    #[test]
    fn an_episode_comes_whole_and_in_order() {
        let mut fixture = fixture();
        fixture.assign(3);
        let (count, end) = fixture.end();
        assert_eq!(count, Puppet::LENGTH);
        assert!(matches!(end, What::Finished(outcome) if outcome.decisions == count), "{end:?}");
    }

    #[test]
    fn of_an_evaluation_only_the_outcome_is_told() {
        let mut fixture = fixture();
        fixture.assign_order(Order { work: Work::Evaluation { version: 0, index: 1 }, ..order(0) });
        let (count, end) = fixture.end();
        assert_eq!(count, 0);
        assert!(matches!(end, What::Finished(outcome) if outcome.decisions == Puppet::LENGTH), "{end:?}");
    }

    #[test]
    fn a_panic_is_told_and_the_robot_replaced() {
        let mut fixture = fixture();
        fixture.assign(Puppet::PANICS);
        assert!(matches!(fixture.end().1, What::Panicked(text) if text.contains("stumbled")));
        fixture.assign(3);
        assert!(matches!(fixture.end().1, What::Finished(_)));
    }

    #[test]
    fn a_cancelled_episode_is_dropped() {
        let mut fixture = fixture();
        fixture.assign(Puppet::ENDLESS).cancel();
        assert!(matches!(fixture.end().1, What::Dropped));
    }

    #[test]
    fn a_robot_whose_listener_left_takes_the_next_order() {
        let mut fixture = fixture();
        let (events, told) = mpsc::channel(1);
        let old = std::mem::replace(&mut fixture.events, events);
        fixture.assign(3);
        drop(told);
        fixture.events = old;
        fixture.assign(4);
        assert!(matches!(fixture.end().1, What::Finished(_)));
    }
}
