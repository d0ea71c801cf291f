//! A queueing model of a herd: N robots, one learner or its parts, told by the service times that were measured.
//!
//! ```text
//! robot ─ episode ─► ingest shard ─► learner ─► the robot begins again
//!                    (first come, first served)   └─ policy ─► link, relays ─► robots
//! ```
//! Discrete events on a whole number of nanoseconds, no dice and no clock: equal settings give equal figures. What it
//! assumes: a robot waits until its episode has been learned from; every episode is equally long; an ingest shard is
//! one journal with its disk; all shards feed one learner; a policy is published when the link has sent the last
//! one, at most 20 times a second; a relay passes a policy on when it has all of it. It knows no failures and no contention of cores.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// What the robots do.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Demand {
    /// How many there are.
    pub(crate) robots: u64,
    /// Wall time of one episode, s.
    pub(crate) episode_secs: f64,
    /// Transitions of one episode.
    pub(crate) decisions: f64,
}

/// How the learning side is built.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Design {
    /// What it is called.
    pub(crate) name: &'static str,
    /// Updates that a transition pays for.
    pub(crate) updates_per_transition: f64,
    /// Updates that the learner makes in a second.
    pub(crate) updates_per_sec: f64,
    /// Transitions that one ingest shard takes in a second, durably.
    pub(crate) ingest_per_sec: f64,
    /// Ingest shards.
    pub(crate) shards: u64,
    /// Robots behind one subscription to the policy.
    pub(crate) robots_per_actor: u64,
    /// Subscribers that one node serves; a tree of relays where there are more.
    pub(crate) fan_out: u64,
    /// Bytes of a policy on the wire.
    pub(crate) policy_bytes: f64,
    /// Bytes per second that a node sends.
    pub(crate) link_bytes_per_sec: f64,
}

/// What comes of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Prediction {
    /// Transitions learned from, per second.
    pub(crate) transitions_per_sec: f64,
    /// Updates per second.
    pub(crate) updates_per_sec: f64,
    /// Share of time that the learner is busy.
    pub(crate) learner: f64,
    /// The same of the busiest shard.
    pub(crate) ingest: f64,
    /// The same of the learner's link, policies out; the newest wins, so a full link delays and stops nothing.
    pub(crate) broadcast: f64,
    /// The same of a shard's link, transitions in.
    pub(crate) link: f64,
    /// Episodes learned from between an episode's policy and itself, mean.
    pub(crate) staleness: f64,
    /// End of an episode → learned from, mean, s.
    pub(crate) wait_secs: f64,
    /// Policy published → at the last subscriber, s.
    pub(crate) delivery_secs: f64,
}

/// Least time between two publications, as in throughput order.
const PUBLISH_SECS: f64 = 0.05;
/// Bytes of one transition on the wire.
const TRANSITION_BYTES: f64 = 488.0;
/// Lengths of an episode that pass before figures count, and that figures are of.
const EPISODES: (f64, f64) = (4.0, 12.0);
/// Events after which a prediction ends, however far it is.
const EVENTS: u64 = 20_000_000;
const NANOS: f64 = 1e9;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    /// A policy of so many learned episodes is everywhere.
    Delivered(u64),
    /// This robot's episode is learned from.
    Learned(u64),
    /// It is in the journal and goes to the learner.
    Kept(u64),
    /// It has ended.
    Ended(u64),
}

struct Robot {
    ended_at: u64,
    version: u64,
}

struct World {
    demand: Demand,
    design: Design,
    events: BinaryHeap<Reverse<(u64, Event)>>,
    robots: Vec<Robot>,
    shard_free: Vec<u64>,
    learner_free: u64,
    link_free: u64,
    learned: u64,
    delivered: u64,
    count: Count,
}

#[derive(Default)]
struct Count {
    episodes: u64,
    staleness: u64,
    wait: u64,
    learner_busy: u64,
    link_busy: u64,
}

/// What becomes of this demand with this design.
pub(crate) fn predict(demand: Demand, design: Design) -> Prediction {
    let mut world = World::new(demand, design);
    let (from, to) = (nanos(EPISODES.0 * demand.episode_secs), nanos((EPISODES.0 + EPISODES.1) * demand.episode_secs));
    let mut last = from;
    for _ in 0..EVENTS {
        let Some(Reverse((at, event))) = world.events.pop() else { break };
        if at > to {
            last = to;
            break;
        }
        last = last.max(at);
        world.handle(at, event, at >= from);
    }
    let secs = ((last - from) as f64 / NANOS).max(f64::MIN_POSITIVE);
    world.prediction(secs)
}

impl World {
    fn new(demand: Demand, design: Design) -> Self {
        let robots: Vec<Robot> = (0..demand.robots).map(|_| Robot { ended_at: 0, version: 0 }).collect();
        // First ends are spread evenly, neighbours far apart.
        let end = |robot: u64| nanos(demand.episode_secs * (robot as f64 * 0.618_033_988_75).fract());
        let events = (0..demand.robots).map(|robot| Reverse((end(robot), Event::Ended(robot)))).collect();
        let shard_free = vec![0; design.shards.max(1) as usize];
        let (learner_free, link_free, learned, delivered, count) = (0, 0, 0, 0, Count::default());
        Self { demand, design, events, robots, shard_free, learner_free, link_free, learned, delivered, count }
    }

    fn handle(&mut self, at: u64, event: Event, counts: bool) {
        match event {
            Event::Ended(robot) => {
                self.robots[robot as usize].ended_at = at;
                let shard = (robot % self.shard_free.len() as u64) as usize;
                let kept = self.shard_free[shard].max(at) + self.ingest_nanos();
                self.shard_free[shard] = kept;
                self.events.push(Reverse((kept, Event::Kept(robot))));
            }
            Event::Kept(robot) => {
                self.learner_free = self.learner_free.max(at) + self.learn_nanos();
                self.events.push(Reverse((self.learner_free, Event::Learned(robot))));
            }
            Event::Learned(robot) => self.learned(at, robot, counts),
            Event::Delivered(version) => self.delivered = self.delivered.max(version),
        }
    }

    fn learned(&mut self, at: u64, robot: u64, counts: bool) {
        self.learned += 1;
        if counts {
            let Robot { ended_at, version } = self.robots[robot as usize];
            self.count.episodes += 1;
            self.count.staleness += self.learned - version;
            self.count.wait += at - ended_at;
            self.count.learner_busy += self.learn_nanos();
        }
        if at >= self.link_free {
            let busy = self.publish_nanos();
            self.link_free = at + busy.max(nanos(PUBLISH_SECS));
            self.events.push(Reverse((at + busy * self.levels(), Event::Delivered(self.learned))));
            self.count.link_busy += if counts { busy } else { 0 };
        }
        self.robots[robot as usize].version = self.delivered;
        self.events.push(Reverse((at + nanos(self.demand.episode_secs), Event::Ended(robot))));
    }

    fn prediction(&self, secs: f64) -> Prediction {
        let Self { count, demand, design, .. } = self;
        let episodes = count.episodes.max(1) as f64;
        let transitions_per_sec = count.episodes as f64 * demand.decisions / secs;
        let shards = self.shard_free.len() as f64;
        let into = transitions_per_sec / shards * TRANSITION_BYTES / design.link_bytes_per_sec;
        Prediction {
            transitions_per_sec,
            updates_per_sec: transitions_per_sec * design.updates_per_transition,
            learner: count.learner_busy as f64 / NANOS / secs,
            ingest: transitions_per_sec / shards / design.ingest_per_sec,
            broadcast: count.link_busy as f64 / NANOS / secs,
            link: into,
            staleness: count.staleness as f64 / episodes,
            wait_secs: count.wait as f64 / NANOS / episodes,
            delivery_secs: (self.publish_nanos() * self.levels()) as f64 / NANOS,
        }
    }

    fn ingest_nanos(&self) -> u64 {
        nanos(self.demand.decisions / self.design.ingest_per_sec)
    }

    fn learn_nanos(&self) -> u64 {
        nanos(self.demand.decisions * self.design.updates_per_transition / self.design.updates_per_sec)
    }

    fn subscribers(&self) -> u64 {
        self.demand.robots.div_ceil(self.design.robots_per_actor.max(1))
    }

    /// Time that the learner's link needs for one policy.
    fn publish_nanos(&self) -> u64 {
        let copies = self.subscribers().min(self.design.fan_out);
        nanos(copies as f64 * self.design.policy_bytes / self.design.link_bytes_per_sec)
    }

    /// Nodes that a policy passes on its way.
    fn levels(&self) -> u64 {
        let (mut reached, mut levels) = (self.design.fan_out.max(2), 1);
        while reached < self.subscribers() {
            reached = reached.saturating_mul(self.design.fan_out.max(2));
            levels += 1;
        }
        levels
    }
}

impl Prediction {
    /// The busiest part, or the robots if none is busy.
    pub(crate) fn bottleneck(&self) -> &'static str {
        let parts =
            [(self.learner, "updates"), (self.ingest, "ingest"), (self.link, "link"), (self.broadcast, "broadcast")];
        let busiest = parts.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
        busiest.filter(|(share, _)| *share > 0.7).map_or("robots", |(_, name)| name)
    }
}

fn nanos(secs: f64) -> u64 {
    (secs * NANOS) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEMAND: Demand = Demand { robots: 20, episode_secs: 10.0, decisions: 80.0 };
    const DESIGN: Design = Design {
        name: "test",
        updates_per_transition: 1.0,
        updates_per_sec: 1e6,
        ingest_per_sec: 1e6,
        shards: 1,
        robots_per_actor: 1,
        fan_out: u64::MAX,
        policy_bytes: 1e6,
        link_bytes_per_sec: 1e9,
    };

    #[track_caller]
    fn close(found: f64, expected: f64) {
        assert!((found / expected - 1.0).abs() < 0.05, "{found}, expected {expected}");
    }

    #[test]
    fn an_idle_learner_follows_the_robots() {
        let found = predict(DEMAND, DESIGN);
        close(found.transitions_per_sec, 20.0 * 80.0 / 10.0);
        // Twenty that were in flight, and the one whose policy was still on its way.
        close(found.staleness, 21.0);
        assert_eq!(found.bottleneck(), "robots");
        assert_eq!(found, predict(DEMAND, DESIGN), "no dice");
    }

    #[test]
    fn a_slow_part_is_busy_and_sets_the_rate() {
        let slow = predict(DEMAND, Design { updates_per_sec: 70.0, ..DESIGN });
        close(slow.transitions_per_sec, 70.0);
        close(slow.learner, 1.0);
        // Little's law: 20 robots, each 10 s away and the rest of the time in the queue.
        close(slow.wait_secs, 20.0 * 80.0 / 70.0 - 10.0);
        assert_eq!(slow.bottleneck(), "updates");
        let slow = predict(DEMAND, Design { ingest_per_sec: 50.0, ..DESIGN });
        close(slow.transitions_per_sec, 50.0);
        assert_eq!(slow.bottleneck(), "ingest");
        let sharded = predict(DEMAND, Design { ingest_per_sec: 50.0, shards: 2, ..DESIGN });
        close(sharded.transitions_per_sec, 100.0);
    }

    #[test]
    fn relays_take_load_off_the_link_and_add_hops() {
        let flat = predict(DEMAND, Design { link_bytes_per_sec: 1e6, ..DESIGN });
        close(flat.delivery_secs, 20.0);
        assert_eq!(flat.bottleneck(), "broadcast");
        let tree = predict(DEMAND, Design { link_bytes_per_sec: 1e6, fan_out: 4, ..DESIGN });
        close(tree.delivery_secs, 3.0 * 4.0);
        assert!(tree.staleness < flat.staleness, "{tree:?} {flat:?}");
    }
}
