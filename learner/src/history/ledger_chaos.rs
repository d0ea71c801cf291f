//! A herd of faulty actors against the ledger: random deaths, expiries, repeats, late messages and learner restarts.
//!
//! Each actor keeps what it believes to hold, also after the ledger took it back, and sends on for it. The model
//! knows from the outside what must hold whatever happens; then the faults stop and the run must complete.

use super::commits::Commits;
use super::lease::Claim;
use super::ledger::{Ledger, Rules};
use super::record::Committed;
use super::refusal::Reason;
use herd_common::config::run::{Exploration, Order};
use herd_common::episode::{Counts, Ending, Outcome, Reward};
use herd_common::spaces::{OBSERVATION_DIM, Task};
use herd_common::transition::{Batch, Transition};
use herd_common::work::Work;
use proptest::prelude::*;
use std::collections::BTreeMap;

const ACTORS: u64 = 4;
const PATIENCE_SECS: f64 = 10.0;

#[derive(Clone, Debug)]
enum Step {
    Lease(u64),
    /// The n-th belief sends this many transitions.
    Send(usize, usize),
    /// The n-th belief sends its last message once more.
    Repeat(usize),
    Finish(usize),
    /// The n-th belief finishes with a wrong count.
    Lie(usize),
    Release(u64),
    Sleep(f64),
    Commit,
    Publish,
    Evaluate,
    Restart,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        6 => (0..ACTORS).prop_map(Step::Lease),
        8 => (any::<usize>(), 0..4_usize).prop_map(|(n, k)| Step::Send(n, k)),
        2 => any::<usize>().prop_map(Step::Repeat),
        6 => any::<usize>().prop_map(Step::Finish),
        1 => any::<usize>().prop_map(Step::Lie),
        1 => (0..ACTORS).prop_map(Step::Release),
        2 => (0.0..8.0).prop_map(Step::Sleep),
        4 => Just(Step::Commit),
        4 => Just(Step::Publish),
        2 => Just(Step::Evaluate),
        1 => Just(Step::Restart),
    ]
}

fn rules() -> impl Strategy<Value = Rules> {
    (any::<bool>(), 0..5_u64, 1..25_u64, 0..6_u64, 1..3_u64).prop_map(|(deterministic, lag, target, every, n)| Rules {
        order: if deterministic { Order::Deterministic } else { Order::Throughput },
        lag,
        target,
        lease_secs: PATIENCE_SECS,
        evaluation_every: every,
        evaluation_episodes: n,
        exploration: Exploration { sigma_min: 0.1, sigma_max: 0.4, rungs: 8, sigma_smoothing: 0.0, warmup_episodes: 0 },
        dims: Task::Gait.dims(),
    })
}

/// What an actor believes to hold.
#[derive(Clone, Debug)]
struct Belief {
    claim: Claim,
    sent: u64,
}

/// Transitions that show who gathered them: the reward names actor and attempt, the observation the position.
fn batch(claim: &Claim, first: u64, count: usize) -> Batch {
    let mut batch = Batch::new(Task::Gait.dims());
    for i in first..first + count as u64 {
        batch.push(Transition {
            observation: &[i as f32 / 1000.0; OBSERVATION_DIM],
            action: &[0.0; 4],
            reward: (claim.actor * 1000 + u64::from(claim.attempt)) as f32,
            discount: 0.5,
            next_observation: &[0.0; OBSERVATION_DIM],
        });
    }
    batch
}

fn outcome(decisions: u64) -> Outcome {
    Outcome {
        ending: if decisions == 0 { Ending::Diverged } else { Ending::TimedOut },
        decisions,
        seconds: decisions as f64,
        reward: Reward::default(),
        distance_m: 0.0,
        roll_variance: 0.0,
        pitch_variance: 0.0,
        counts: Counts::default(),
    }
}

struct World {
    rules: Rules,
    ledger: Ledger,
    now: f64,
    beliefs: Vec<Belief>,
    /// The journal: what was committed and evaluated, in order.
    committed: Vec<Committed>,
    evaluated: Vec<u64>,
    published: u64,
    /// Which claim finished which work, by the ledger's word.
    finished: BTreeMap<Work, (Claim, u64)>,
}

impl World {
    fn new(rules: Rules) -> Self {
        let ledger = Ledger::new(rules.clone(), Commits::default(), None);
        let (beliefs, committed, evaluated, finished) = Default::default();
        Self { rules, ledger, now: 0.0, beliefs, committed, evaluated, published: 0, finished }
    }

    fn belief(&mut self, n: usize) -> Option<&mut Belief> {
        let len = self.beliefs.len();
        (len > 0).then(|| &mut self.beliefs[n % len])
    }

    /// The belief is the ledger's newest lease of that work, as far as the outside can tell.
    fn is_newest(&self, belief: &Belief) -> bool {
        let of_same_work = |other: &&Belief| other.claim.work == belief.claim.work;
        let newest = self.beliefs.iter().filter(of_same_work).map(|b| b.claim.attempt).max();
        newest == Some(belief.claim.attempt)
    }

    fn apply(&mut self, step: &Step) {
        match *step {
            Step::Lease(actor) => self.lease(actor),
            Step::Send(n, count) => self.send(n, count),
            Step::Repeat(n) => self.repeat(n),
            Step::Finish(n) => self.finish(n),
            Step::Lie(n) => {
                if let Some(Belief { claim, sent, .. }) = self.belief(n).cloned()
                    && matches!(claim.work, Work::Episode(_))
                {
                    self.ledger.finish(&claim, outcome(sent + 1)).expect_err("counts what it did not send");
                }
            }
            Step::Release(actor) => {
                let released = self.ledger.release(actor);
                assert!(released.iter().all(|work| self.beliefs.iter().any(|b| b.claim.work == *work)));
                assert_eq!(self.ledger.leases_of(actor), 0);
            }
            Step::Sleep(secs) => {
                self.now += secs;
                self.ledger.expire(self.now);
            }
            Step::Commit => self.commit(),
            Step::Publish => {
                self.published = self.published.max(self.committed.len() as u64);
                self.ledger.published(self.published);
            }
            Step::Evaluate => self.evaluate(),
            Step::Restart => self.restart(),
        }
        assert!(self.ledger.in_flight() <= self.rules.lag + 1);
    }

    fn lease(&mut self, actor: u64) {
        let Some(lease) = self.ledger.lease(actor, self.now).expect("few attempts") else { return };
        assert!(lease.version <= self.published, "the policy can be fetched");
        assert!(self.ledger.wants(lease.version), "the policy is kept");
        match (lease.work, self.rules.order) {
            (Work::Episode(e), Order::Deterministic) => assert_eq!(lease.version, e.saturating_sub(self.rules.lag)),
            (Work::Episode(_), Order::Throughput) => assert_eq!(lease.version, self.published),
            (Work::Evaluation { version, .. }, _) => assert_eq!((lease.version, lease.sigma), (version, 0.0)),
        }
        if let Work::Episode(e) = lease.work {
            assert!(e < self.rules.target);
            assert!(self.committed.iter().all(|c| c.episode != e), "leased after its commit");
        }
        assert!(!self.finished.contains_key(&lease.work), "leased after it was finished");
        let claim = Claim { actor, work: lease.work, attempt: lease.attempt };
        self.beliefs.push(Belief { claim, sent: 0 });
    }

    fn send(&mut self, n: usize, count: usize) {
        let Some(belief) = self.belief(n).cloned() else { return };
        let count = if matches!(belief.claim.work, Work::Episode(_)) { count } else { 0 };
        let batch = batch(&belief.claim, belief.sent, count);
        if self.ledger.transitions(&belief.claim, belief.sent, &batch, self.now).is_ok() {
            assert!(self.is_newest(&belief), "only the newest lease is heard");
            self.belief(n).expect("it is there").sent += count as u64;
        }
    }

    fn repeat(&mut self, n: usize) {
        let Some(Belief { claim, sent, .. }) = self.belief(n).cloned() else { return };
        if sent > 0 {
            let refusal = self.ledger.transitions(&claim, sent - 1, &batch(&claim, sent - 1, 1), self.now);
            refusal.expect_err("what is staged is not staged again");
        }
        let refusal = self.ledger.transitions(&claim, sent + 1, &batch(&claim, sent + 1, 0), self.now);
        refusal.expect_err("nothing is left out");
        if let Some((winner, _)) = self.finished.get(&claim.work) {
            let reason = self.ledger.finish(&claim, outcome(sent)).expect_err("it is finished").reason;
            let by_attempt = winner.attempt;
            assert!(reason == Reason::Committed || reason == Reason::Finished { by_attempt }, "{reason:?}");
        }
    }

    fn finish(&mut self, n: usize) {
        let Some(belief) = self.belief(n).cloned() else { return };
        let decisions = if matches!(belief.claim.work, Work::Episode(_)) { belief.sent } else { 1 };
        if self.ledger.finish(&belief.claim, outcome(decisions)).is_ok() {
            assert!(self.is_newest(&belief), "only the newest lease can finish");
            let before = self.finished.insert(belief.claim.work, (belief.claim, belief.sent));
            assert_eq!(before, None, "work is finished once");
        }
    }

    fn commit(&mut self) {
        let Some(commit) = self.ledger.next_commit() else { return };
        let work = Work::Episode(commit.episode);
        let (claim, sent) = self.finished[&work];
        assert_eq!(commit.transitions, batch(&claim, 0, sent as usize), "the transitions of one attempt, all of them");
        assert_eq!(commit.outcome, outcome(sent));
        assert_eq!(commit.sigma, self.rules.exploration.sigma(commit.episode) as f32);
        assert!(self.committed.iter().all(|c| c.episode != commit.episode), "committed once");
        if self.rules.order == Order::Deterministic {
            assert_eq!(commit.episode, self.committed.len() as u64, "by number");
            assert_eq!(commit.version, commit.episode.saturating_sub(self.rules.lag));
        }
        self.committed.push(commit);
    }

    fn evaluate(&mut self) {
        let Some((version, outcomes)) = self.ledger.next_evaluation() else { return };
        assert!(self.evaluated.last().is_none_or(|last| *last < version), "by version, once");
        assert_eq!(outcomes, vec![outcome(1); self.rules.evaluation_episodes as usize]);
        self.evaluated.push(version);
    }

    /// The learner dies: only what was committed and evaluated is left. Old connections are gone, so nothing that an
    /// actor believed before reaches the new ledger.
    fn restart(&mut self) {
        let mut commits = Commits::default();
        assert!(self.committed.iter().all(|c| commits.insert(c.episode)));
        self.ledger = Ledger::new(self.rules.clone(), commits, self.evaluated.last().copied());
        self.published = self.committed.len() as u64;
        self.beliefs.clear();
        self.finished.retain(|work, _| match work {
            Work::Episode(e) => self.committed.iter().any(|c| c.episode == *e),
            Work::Evaluation { version, .. } => self.evaluated.contains(version),
        });
    }

    /// No more faults: actors that finish what they lease, a trainer that keeps up.
    fn complete(&mut self) {
        self.now += PATIENCE_SECS + 1.0;
        self.ledger.expire(self.now);
        for turn in 0..1000 {
            if self.ledger.is_complete() {
                return;
            }
            self.beliefs.clear();
            self.lease(turn % ACTORS);
            self.send(0, 2);
            self.finish(0);
            self.commit();
            self.apply(&Step::Publish);
            self.evaluate();
        }
        panic!("the run does not complete: {:?}", self.ledger);
    }

    fn check_whole(&self) {
        let target = self.rules.target;
        let mut episodes: Vec<u64> = self.committed.iter().map(|c| c.episode).collect();
        episodes.sort_unstable();
        assert_eq!(episodes, (0..target).collect::<Vec<_>>());
        let every = self.rules.evaluation_every;
        let due = (0..=target).filter(|v| every > 0 && (v % every == 0 || *v == target));
        assert_eq!(self.evaluated, due.collect::<Vec<_>>());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn every_episode_is_committed_once_whatever_happens(
        rules in rules(),
        steps in prop::collection::vec(step(), 0..300),
    ) {
        let mut world = World::new(rules);
        for step in &steps {
            world.apply(step);
        }
        world.complete();
        world.check_whole();
    }
}
