//! Decides who may run which episode, with which policy, and what is committed when.
//!
//! | symbol | name | meaning |
//! |---|---|---|
//! | e | episode | 0, 1, 2, …; the key by which an episode is counted once |
//! | v | version | policy after v commits; 0 is the untrained one |
//! | lag | lag | episode e of the deterministic order runs with version max(0, e − lag) |
//!
//! A pure state machine: time is an argument (s, from any fixed origin), nothing is read or written. A refused message
//! changes nothing. The caller moves it on: it takes commits with [`Ledger::next_commit`], keeps them, learns from them
//! and says with [`Ledger::published`] when the policy that follows can be fetched; leases never name a policy
//! that cannot.

use super::commits::Commits;
use super::holders::Holders;
use super::lease::{Claim, Exhausted, FIRST_EVALUATION, Lease};
use super::record::Committed;
use super::refusal::{Reason, Refusal};
use herd_common::caps;
use herd_common::config::run::{Exploration, Order};
use herd_common::episode::{Ending, Outcome};
use herd_common::spaces::Dims;
use herd_common::transition::Batch;
use herd_common::work::Work;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// What the ledger goes by.
#[derive(Clone, Debug, PartialEq)]
pub struct Rules {
    /// Order of commits.
    pub order: Order,
    /// Episodes that a policy may be behind; one more may be in flight.
    pub lag: u64,
    /// Episodes that the run is to have.
    pub target: u64,
    /// Patience with a lease that makes no progress, s.
    pub lease_secs: f64,
    /// Commits between two evaluations; 0 for none. Version 0 and the final version are evaluated too.
    pub evaluation_every: u64,
    /// Episodes of one evaluation.
    pub evaluation_episodes: u64,
    /// Noise by episode number.
    pub exploration: Exploration,
    /// Lengths of the task's spaces.
    pub dims: Dims,
}

#[derive(Debug, Default)]
struct Entry {
    attempts: u32,
    state: State,
}

#[derive(Debug, Default)]
enum State {
    #[default]
    Free,
    Leased(Held),
    Finished(Finished),
}

#[derive(Debug)]
struct Held {
    actor: u64,
    version: u64,
    progress_at: f64,
    staged: Batch,
}

#[derive(Debug)]
struct Finished {
    version: u64,
    outcome: Outcome,
    transitions: Batch,
}

/// The state of all work that is not yet part of the run.
#[derive(Debug)]
pub struct Ledger {
    rules: Rules,
    commits: Commits,
    /// Newest policy that can be fetched; it trails `commits` while the trainer learns.
    published: u64,
    /// Lowest episode that was neither leased here nor committed before.
    next: u64,
    /// Episodes leased at least once and not committed, and every episode of each evaluation in `due`.
    entries: BTreeMap<Work, Entry>,
    /// Entries that nobody holds; the first is the next to lease.
    free: BTreeSet<Work>,
    holders: Holders,
    /// Throughput order: finished episodes by arrival.
    arrived: VecDeque<u64>,
    /// Versions whose evaluation is not over.
    due: BTreeSet<u64>,
    /// Newest version whose evaluation is over; those below it are too.
    evaluated: Option<u64>,
}

impl Ledger {
    /// A ledger that goes on after `commits` and after the evaluation of version `evaluated`.
    pub fn new(rules: Rules, commits: Commits, evaluated: Option<u64>) -> Self {
        let published = commits.count();
        let mut ledger = Self {
            rules,
            published,
            next: commits.first_missing(),
            commits,
            entries: BTreeMap::new(),
            free: BTreeSet::new(),
            holders: Holders::default(),
            arrived: VecDeque::new(),
            due: BTreeSet::new(),
            evaluated,
        };
        ledger.rules.target = ledger.rules.target.max(ledger.commits.end());
        if ledger.rules.evaluation_every > 0 {
            (0..=published).step_by(ledger.rules.evaluation_every as usize).for_each(|v| ledger.make_due(v));
        }
        ledger.make_due(published);
        ledger
    }

    // ---- leases ----

    /// The most urgent work for an actor: what others gave up, then evaluations, then new episodes, lowest first.
    /// `None` when everything allowed now is under way.
    pub fn lease(&mut self, actor: u64, now: f64) -> Result<Option<Lease>, Exhausted> {
        let Some(work) = self.free.first().copied().or_else(|| self.new_episode()) else {
            return Ok(None);
        };
        let (version, sigma) = match work {
            Work::Episode(episode) => (self.version_for(episode), self.sigma(episode)),
            Work::Evaluation { version, .. } => (version, 0.0),
        };
        let entry = self.entries.entry(work).or_default();
        if entry.attempts >= caps::LEASES_PER_EPISODE {
            return Err(Exhausted { work, leases: entry.attempts });
        }
        entry.attempts += 1;
        let staged = Batch::new(self.rules.dims);
        entry.state = State::Leased(Held { actor, version, progress_at: now, staged });
        let attempt = entry.attempts;
        self.holders.take(actor);
        self.free.remove(&work);
        while self.commits.contains(self.next) || self.entries.contains_key(&Work::Episode(self.next)) {
            self.next += 1;
        }
        Ok(Some(Lease { work, attempt, version, sigma }))
    }

    /// Stages transitions `first ..` of a lease. An empty batch counts as a sign of life.
    pub fn transitions(&mut self, claim: &Claim, first: u64, batch: &Batch, now: f64) -> Result<(), Refusal> {
        let dims = self.rules.dims;
        let held = self.held(claim)?;
        let staged = held.staged.len() as u64;
        let all = staged + batch.len() as u64;
        let reason = if matches!(claim.work, Work::Evaluation { .. }) && !batch.is_empty() {
            Some(Reason::Evaluation { found: batch.len() as u64 })
        } else if first != staged {
            Some(Reason::Gap { expected: staged, found: first })
        } else if all > caps::TRANSITIONS_PER_EPISODE as u64 {
            Some(Reason::TooMany { found: all })
        } else if batch.dims() != dims {
            Some(Reason::Dims { found: batch.dims(), expected: dims })
        } else {
            batch.validate().err().map(Reason::from)
        };
        if let Some(reason) = reason {
            return Err(Refusal { claim: *claim, reason });
        }
        held.staged.append(batch);
        held.progress_at = now;
        Ok(())
    }

    /// Ends a lease with its outcome: the work waits for its commit.
    pub fn finish(&mut self, claim: &Claim, outcome: Outcome) -> Result<(), Refusal> {
        let held = self.held(claim)?;
        let staged = held.staged.len() as u64;
        let evaluation = matches!(claim.work, Work::Evaluation { .. });
        let reason = if let Some((field, value)) = outcome.first_invalid() {
            Some(Reason::Outcome { field, value })
        } else if !evaluation && outcome.decisions != staged {
            Some(Reason::Count { decisions: outcome.decisions, staged })
        } else if outcome.decisions == 0 && outcome.ending != Ending::Diverged {
            Some(Reason::Empty { ending: outcome.ending.name() })
        } else {
            None
        };
        if let Some(reason) = reason {
            return Err(Refusal { claim: *claim, reason });
        }
        let transitions = std::mem::take(&mut held.staged);
        let finished = Finished { version: held.version, outcome, transitions };
        self.entries.entry(claim.work).or_default().state = State::Finished(finished);
        self.holders.let_go([claim.actor]);
        if let (Work::Episode(episode), Order::Throughput) = (claim.work, self.rules.order) {
            self.arrived.push_back(episode);
        }
        Ok(())
    }

    /// Takes back every lease of an actor that left; what it had sent is forgotten.
    pub fn release(&mut self, actor: u64) -> Vec<Work> {
        self.take_back(|held| held.actor == actor).into_iter().map(|(_, work)| work).collect()
    }

    /// Gives up the lease that a claim names; nothing happens when it does not hold.
    pub fn surrender(&mut self, claim: &Claim) {
        if self.held(claim).is_ok() {
            self.entries.entry(claim.work).or_default().state = State::Free;
            self.free.insert(claim.work);
            self.holders.let_go([claim.actor]);
        }
    }

    /// Takes back every lease without progress for longer than the patience; returns who had what.
    pub fn expire(&mut self, now: f64) -> Vec<(u64, Work)> {
        let patience = self.rules.lease_secs;
        self.take_back(|held| now - held.progress_at > patience)
    }

    // ---- commits ----

    /// The next episode to become part of the run: from this call on it counts as committed. In deterministic order
    /// episodes come by number, in throughput order as they finished.
    pub fn next_commit(&mut self) -> Option<Committed> {
        let episode = match self.rules.order {
            Order::Deterministic => self.commits.first_missing(),
            Order::Throughput => *self.arrived.front()?,
        };
        let Finished { version, outcome, transitions } = self.take_finished(Work::Episode(episode))?;
        self.arrived.pop_front();
        self.commits.insert(episode);
        Some(Committed { episode, version, sigma: self.sigma(episode), outcome, transitions })
    }

    /// Says that the policy after `version` commits can be fetched from now on.
    pub fn published(&mut self, version: u64) {
        assert!(version <= self.commits.count(), "version {version} needs as many commits");
        for v in self.published + 1..=version {
            self.published = v;
            self.make_due(v);
        }
    }

    /// The next evaluation that is over, by version: the outcomes in order of their index.
    pub fn next_evaluation(&mut self) -> Option<(u64, Vec<Outcome>)> {
        let version = *self.due.first()?;
        let all = Self::evaluation_range(version);
        if !self.entries.range(all.clone()).all(|(_, entry)| matches!(entry.state, State::Finished(_))) {
            return None;
        }
        let works: Vec<Work> = self.entries.range(all).map(|(work, _)| *work).collect();
        let outcomes = works.into_iter().filter_map(|work| self.take_finished(work)).map(|f| f.outcome).collect();
        self.due.pop_first();
        self.evaluated = Some(version);
        Some((version, outcomes))
    }

    /// Takes in a commit that the journal holds already; nothing may be leased yet.
    pub fn recommit(&mut self, episode: u64) {
        self.commits.insert(episode);
        while self.commits.contains(self.next) {
            self.next += 1;
        }
    }

    /// Takes in an evaluation that the journal holds already.
    pub fn reevaluate(&mut self, version: u64) {
        self.drop_evaluation(version);
        self.evaluated = self.evaluated.max(Some(version));
    }

    /// Gives up the evaluations of policies that no longer exist, after a restart with other settings.
    pub fn forgo_evaluations(&mut self, has_policy: impl Fn(u64) -> bool) {
        for version in self.due.iter().copied().filter(|v| !has_policy(*v)).collect::<Vec<_>>() {
            self.drop_evaluation(version);
        }
    }

    fn drop_evaluation(&mut self, version: u64) {
        self.due.remove(&version);
        let holder = |entry: &Entry| if let State::Leased(held) = &entry.state { Some(held.actor) } else { None };
        let entries = self.entries.range(Self::evaluation_range(version));
        self.holders.let_go(entries.filter_map(|(_, entry)| holder(entry)));
        self.entries.retain(|work, _| !Self::evaluation_range(version).contains(work));
        self.free.retain(|work| !Self::evaluation_range(version).contains(work));
    }

    /// Changes how many episodes the run is to have and returns what holds: at least those leased so far.
    pub fn set_target(&mut self, target: u64) -> u64 {
        self.rules.target = target.max(self.next).max(self.commits.end());
        self.make_due(self.published);
        self.rules.target
    }

    // ---- views ----

    /// What is committed.
    pub fn commits(&self) -> &Commits {
        &self.commits
    }

    /// Newest version whose evaluation is over.
    pub fn evaluated(&self) -> Option<u64> {
        self.evaluated
    }

    /// Episodes leased at least once and not committed yet, at most lag + 1.
    pub fn in_flight(&self) -> u64 {
        self.entries.len() as u64 - self.due.len() as u64 * self.rules.evaluation_episodes
    }

    /// Leases that an actor holds.
    pub fn leases_of(&self, actor: u64) -> usize {
        self.holders.of(actor)
    }

    /// True when an actor that asks now is given something.
    pub fn has_work(&self) -> bool {
        !self.free.is_empty() || self.new_episode().is_some()
    }

    /// True when the policy of this version is to be evaluated, so that it must be published even if others follow at
    /// once.
    pub fn evaluates(&self, version: u64) -> bool {
        let Rules { evaluation_every: every, evaluation_episodes: episodes, target, .. } = self.rules;
        every > 0 && episodes > 0 && (version.is_multiple_of(every) || version == target)
    }

    /// True when the policy of this version may still be named by a lease, so it must be kept.
    pub fn wants(&self, version: u64) -> bool {
        let oldest = match self.rules.order {
            Order::Deterministic => self.version_for(self.commits.first_missing()),
            Order::Throughput => {
                let held = |entry: &Entry| match &entry.state {
                    State::Leased(held) => Some(held.version),
                    State::Free | State::Finished(_) => None,
                };
                self.entries.range(..FIRST_EVALUATION).filter_map(|(_, e)| held(e)).fold(self.published, u64::min)
            }
        };
        version >= oldest || self.due.contains(&version)
    }

    /// True when every episode is committed, its policy published and every evaluation over.
    pub fn is_complete(&self) -> bool {
        let all_committed = self.commits.first_missing() >= self.rules.target;
        all_committed && self.published == self.commits.count() && self.due.is_empty()
    }

    // ---- inside ----

    fn new_episode(&self) -> Option<Work> {
        let open = match self.rules.order {
            Order::Deterministic => self.next <= self.published + self.rules.lag,
            // Commits that are not learned from yet count too, all but the one that is being learned from: else actors
            // would run ahead of the learner by as much as fits into one sync.
            Order::Throughput => {
                let unlearned = (self.commits.count() - self.published).saturating_sub(1);
                self.in_flight() + unlearned <= self.rules.lag
            }
        };
        let caught_up = self.due.len() <= caps::EVALUATIONS_BEHIND;
        (open && caught_up && self.next < self.rules.target).then_some(Work::Episode(self.next))
    }

    fn version_for(&self, episode: u64) -> u64 {
        match self.rules.order {
            Order::Deterministic => episode.saturating_sub(self.rules.lag),
            Order::Throughput => self.published,
        }
    }

    fn sigma(&self, episode: u64) -> f32 {
        self.rules.exploration.sigma(episode) as f32
    }

    /// The lease that a claim names, if it holds.
    fn held(&mut self, claim: &Claim) -> Result<&mut Held, Refusal> {
        let refuse = |reason| Err(Refusal { claim: *claim, reason });
        let over = match claim.work {
            Work::Episode(episode) => self.commits.contains(episode),
            Work::Evaluation { version, .. } => self.evaluated.is_some_and(|last| version <= last),
        };
        let Some(entry) = self.entries.get_mut(&claim.work) else {
            return refuse(if over { Reason::Committed } else { Reason::Unknown });
        };
        let attempts = entry.attempts;
        let reason = match &entry.state {
            State::Leased(held) if held.actor == claim.actor && attempts == claim.attempt => None,
            State::Leased(held) => Some(Reason::Stale { holder: held.actor, holder_attempt: attempts }),
            State::Finished(_) => Some(Reason::Finished { by_attempt: attempts }),
            State::Free if attempts == 0 => Some(Reason::Unknown),
            State::Free => Some(Reason::TakenBack { last_attempt: attempts }),
        };
        match (reason, &mut entry.state) {
            (None, State::Leased(held)) => Ok(held),
            (reason, _) => refuse(reason.unwrap_or(Reason::Unknown)),
        }
    }

    fn take_back(&mut self, lost: impl Fn(&Held) -> bool) -> Vec<(u64, Work)> {
        let mut taken = Vec::new();
        for (work, entry) in &mut self.entries {
            if let State::Leased(held) = &entry.state
                && lost(held)
            {
                taken.push((held.actor, *work));
                entry.state = State::Free;
                self.free.insert(*work);
            }
        }
        self.holders.let_go(taken.iter().map(|(actor, _)| *actor));
        taken
    }

    fn take_finished(&mut self, work: Work) -> Option<Finished> {
        if !matches!(self.entries.get(&work)?.state, State::Finished(_)) {
            return None;
        }
        match self.entries.remove(&work)?.state {
            State::Finished(finished) => Some(finished),
            State::Free | State::Leased(_) => None,
        }
    }

    /// Schedules the evaluation of a version that is due and neither over nor scheduled.
    fn make_due(&mut self, version: u64) {
        if !self.evaluates(version) || self.evaluated.is_some_and(|last| version <= last) || !self.due.insert(version) {
            return;
        }
        for index in 0..self.rules.evaluation_episodes {
            let work = Work::Evaluation { version, index };
            self.entries.insert(work, Entry::default());
            self.free.insert(work);
        }
    }

    fn evaluation_range(version: u64) -> std::ops::RangeInclusive<Work> {
        Work::Evaluation { version, index: 0 }..=Work::Evaluation { version, index: u64::MAX }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::episode::{Counts, Reward};
    use herd_common::spaces::{OBSERVATION_DIM, Task};
    use herd_common::transition::Transition;

    fn rules(order: Order, lag: u64, target: u64) -> Rules {
        let exploration =
            Exploration { sigma_min: 0.1, sigma_max: 0.1, rungs: 1, sigma_smoothing: 0.0, warmup_episodes: 0 };
        Rules {
            order,
            lag,
            target,
            lease_secs: 10.0,
            evaluation_every: 0,
            evaluation_episodes: 2,
            exploration,
            dims: Task::Gait.dims(),
        }
    }

    fn ledger(order: Order, lag: u64, target: u64) -> Ledger {
        Ledger::new(rules(order, lag, target), Commits::default(), None)
    }

    fn batch(count: usize) -> Batch {
        let mut batch = Batch::new(Task::Gait.dims());
        let (observation, next_observation) = (&[0.0; OBSERVATION_DIM], &[0.0; OBSERVATION_DIM]);
        for _ in 0..count {
            batch.push(Transition { observation, action: &[0.0; 4], reward: 1.0, discount: 0.5, next_observation });
        }
        batch
    }

    fn outcome(decisions: u64, ending: Ending) -> Outcome {
        Outcome {
            ending,
            decisions,
            seconds: 1.0,
            reward: Reward::default(),
            distance_m: 0.0,
            roll_variance: 0.0,
            pitch_variance: 0.0,
            counts: Counts::default(),
        }
    }

    fn lease(ledger: &mut Ledger, actor: u64) -> Option<(Claim, u64)> {
        let lease = ledger.lease(actor, 0.0).expect("not exhausted")?;
        Some((Claim { actor, work: lease.work, attempt: lease.attempt }, lease.version))
    }

    fn run(ledger: &mut Ledger, claim: &Claim) {
        let decisions = u64::from(matches!(claim.work, Work::Episode(_)));
        ledger.transitions(claim, 0, &batch(decisions as usize), 0.0).expect("accepted");
        ledger.finish(claim, outcome(1, Ending::TimedOut)).expect("accepted");
    }

    /// Leases and finishes everything that may run now; returns it.
    fn run_all(ledger: &mut Ledger) -> Vec<Work> {
        let mut works = Vec::new();
        while let Some((claim, _)) = lease(ledger, 0) {
            run(ledger, &claim);
            works.push(claim.work);
        }
        works
    }

    #[track_caller]
    fn check<T: std::fmt::Debug>(result: Result<T, Refusal>, text: &str) {
        assert_eq!(result.expect_err("refused").to_string(), text);
    }

    #[test]
    fn lag_bounds_what_is_in_flight_until_the_policy_is_published() {
        let mut ledger = ledger(Order::Deterministic, 2, 100);
        assert_eq!(run_all(&mut ledger), [0, 1, 2].map(Work::Episode));
        assert_eq!(ledger.next_commit().map(|c| (c.episode, c.version)), Some((0, 0)));
        assert_eq!(lease(&mut ledger, 0), None, "version 1 cannot be fetched yet");
        ledger.published(1);
        assert_eq!(lease(&mut ledger, 0).map(|(claim, version)| (claim.work, version)), Some((Work::Episode(3), 1)));
        assert!(ledger.wants(0), "episodes 1 and 2 may have to run again");
        assert_eq!([(); 3].map(|()| ledger.next_commit().map(|c| c.version)), [Some(0), Some(0), None]);
        assert!(!ledger.wants(0) && ledger.wants(1));
    }

    #[test]
    fn throughput_commits_by_arrival_with_the_newest_policy() {
        let mut ledger = ledger(Order::Throughput, 1, 3);
        let (zero, _) = lease(&mut ledger, 7).expect("free");
        let (one, _) = lease(&mut ledger, 8).expect("free");
        assert_eq!(lease(&mut ledger, 9), None, "two in flight");
        run(&mut ledger, &one);
        assert_eq!(ledger.next_commit().map(|c| c.episode), Some(1));
        ledger.published(1);
        let (two, version) = lease(&mut ledger, 8).expect("free");
        assert_eq!((two.work, version), (Work::Episode(2), 1));
        assert!(ledger.wants(0), "actor 7 may not have fetched it yet");
        assert!(!{
            run(&mut ledger, &zero);
            ledger.wants(0)
        });
        let mut commits = Commits::default();
        assert!(commits.insert(1) && commits.insert(2));
        let mut resumed = Ledger::new(rules(Order::Throughput, 1, 4), commits, None);
        assert_eq!(run_all(&mut resumed), [0, 3].map(Work::Episode), "the hole first, then new ones");
    }

    #[test]
    fn evaluations_go_before_new_episodes_and_after_lost_ones() {
        let mut rules = rules(Order::Deterministic, 1, 3);
        rules.evaluation_every = 2;
        let mut ledger = Ledger::new(rules, Commits::default(), None);
        let evaluation = |version| [0, 1].map(|index| Work::Evaluation { version, index });
        assert_eq!(run_all(&mut ledger)[..2], evaluation(0));
        for version in 1..=2 {
            ledger.next_commit().expect("finished");
            ledger.published(version);
        }
        let works: Vec<Work> = (0..3).filter_map(|_| lease(&mut ledger, 5)).map(|(claim, _)| claim.work).collect();
        assert_eq!(works, [&evaluation(2)[..], &[Work::Episode(2)]].concat());
        assert!(ledger.wants(2) && ledger.wants(1) && ledger.wants(0), "{ledger:?}");
        ledger.release(5);
        assert_eq!(run_all(&mut ledger), [&[Work::Episode(2)], &evaluation(2)[..]].concat());
        assert_eq!(ledger.next_evaluation().map(|(version, outcomes)| (version, outcomes.len())), Some((0, 2)));
        assert!(!ledger.wants(0));
        ledger.next_commit().expect("finished");
        assert!(!ledger.is_complete());
        ledger.published(3);
        assert_eq!(run_all(&mut ledger), evaluation(3), "the final version");
        assert_eq!([(); 3].map(|()| ledger.next_evaluation().map(|(v, _)| v)), [Some(2), Some(3), None]);
        assert!(ledger.is_complete());
    }

    #[test]
    fn new_episodes_wait_when_evaluations_fall_behind() {
        let mut rules = rules(Order::Throughput, 0, 100);
        rules.evaluation_every = 1;
        rules.evaluation_episodes = 1;
        let mut ledger = Ledger::new(rules, Commits::default(), None);
        for version in 0..=caps::EVALUATIONS_BEHIND as u64 {
            let (stuck, _) = lease(&mut ledger, 1).expect("due");
            assert_eq!(stuck.work, Work::Evaluation { version, index: 0 });
            match lease(&mut ledger, 2) {
                Some((claim, _)) => run(&mut ledger, &claim),
                None => assert_eq!(version, caps::EVALUATIONS_BEHIND as u64),
            }
            if ledger.next_commit().is_some() {
                ledger.published(version + 1);
            }
        }
        assert_eq!(ledger.commits().count(), caps::EVALUATIONS_BEHIND as u64);
        ledger.forgo_evaluations(|version| version != 3);
        assert_eq!(lease(&mut ledger, 2).map(|(claim, _)| claim.work), Some(Work::Episode(8)));
    }

    #[test]
    fn refusals_tell_both_sides() {
        let mut ledger = ledger(Order::Deterministic, 4, 9);
        let (old, _) = lease(&mut ledger, 3).expect("free");
        check(
            ledger.transitions(&old, 2, &batch(1), 0.0),
            "actor 3, attempt 1 of episode 0: transitions start at 2, expected 0",
        );
        let wide = Batch::new(Task::Torque.dims());
        check(
            ledger.transitions(&old, 0, &wide, 0.0),
            "actor 3, attempt 1 of episode 0: observations and actions have 56 and 12 numbers, expected 56 and 4",
        );
        check(
            ledger.transitions(&old, 0, &Batch::new(Task::Command.dims()), 0.0),
            "actor 3, attempt 1 of episode 0: observations and actions have 59 and 4 numbers, expected 56 and 4",
        );
        ledger.transitions(&old, 0, &batch(2), 0.0).expect("accepted");
        let count = "actor 3, attempt 1 of episode 0: outcome counts 3 decisions, expected 2, the number of transitions that arrived";
        check(ledger.finish(&old, outcome(3, Ending::TimedOut)), count);
        assert_eq!(ledger.expire(11.0), vec![(3, Work::Episode(0))]);
        check(
            ledger.finish(&old, outcome(2, Ending::TimedOut)),
            "actor 3, attempt 1 of episode 0: the lease was taken back after attempt 1, nobody holds it",
        );
        let (new, _) = lease(&mut ledger, 5).expect("free");
        check(
            ledger.finish(&old, outcome(2, Ending::TimedOut)),
            "actor 3, attempt 1 of episode 0: stale, actor 5 holds the lease as attempt 2",
        );
        check(
            ledger.finish(&new, outcome(0, Ending::TimedOut)),
            "actor 5, attempt 2 of episode 0: outcome timed_out without a decision, expected at least one unless the simulation diverged",
        );
        ledger.finish(&new, outcome(0, Ending::Diverged)).expect("accepted");
        check(
            ledger.finish(&old, outcome(2, Ending::TimedOut)),
            "actor 3, attempt 1 of episode 0: already finished by attempt 2, waits to be committed",
        );
        assert_eq!(ledger.next_commit().map(|c| c.transitions), Some(Batch::new(Task::Gait.dims())));
        check(ledger.finish(&new, outcome(2, Ending::TimedOut)), "actor 5, attempt 2 of episode 0: already committed");
        let never = Claim { actor: 1, work: Work::Episode(8), attempt: 1 };
        check(
            ledger.finish(&never, outcome(2, Ending::TimedOut)),
            "actor 1, attempt 1 of episode 8: this work was not leased",
        );
    }

    #[test]
    fn bounds_hold() {
        let mut ledger = ledger(Order::Deterministic, 4, 9);
        let (claim, _) = lease(&mut ledger, 3).expect("free");
        ledger.transitions(&claim, 0, &batch(caps::TRANSITIONS_PER_EPISODE), 0.0).expect("accepted");
        let more = ledger.transitions(&claim, caps::TRANSITIONS_PER_EPISODE as u64, &batch(1), 0.0);
        check(more, "actor 3, attempt 1 of episode 0: 10001 transitions, expected at most 10000");
        for attempt in 2..=caps::LEASES_PER_EPISODE {
            assert_eq!(ledger.release(3), [Work::Episode(0)]);
            assert_eq!(lease(&mut ledger, 3).map(|(claim, _)| claim.attempt), Some(attempt));
        }
        ledger.release(3);
        let error = ledger.lease(3, 0.0).expect_err("exhausted").to_string();
        assert_eq!(error, "episode 0 was leased 100 times without being finished, expected at most 100");
    }

    #[test]
    fn progress_renews_a_lease() {
        let mut ledger = ledger(Order::Deterministic, 4, 9);
        let (claim, _) = lease(&mut ledger, 3).expect("free");
        ledger.transitions(&claim, 0, &batch(0), 8.0).expect("a sign of life");
        assert_eq!(ledger.expire(18.0), vec![]);
        assert_eq!(ledger.expire(18.1), vec![(3, Work::Episode(0))]);
    }

    #[test]
    fn a_lower_target_keeps_what_is_leased_and_a_higher_one_goes_on() {
        let mut ledger = ledger(Order::Deterministic, 1, 9);
        lease(&mut ledger, 0).expect("free");
        assert_eq!(ledger.set_target(0), 1);
        ledger.release(0);
        assert_eq!(run_all(&mut ledger), [Work::Episode(0)]);
        ledger.next_commit().expect("finished");
        ledger.published(1);
        assert!(ledger.is_complete());
        assert_eq!(ledger.set_target(2), 2);
        assert!(!ledger.is_complete());
        assert_eq!(run_all(&mut ledger), [Work::Episode(1)]);
    }

    #[test]
    fn a_surrendered_lease_is_free_for_others_and_a_foreign_claim_frees_nothing() {
        let mut ledger = ledger(Order::Deterministic, 4, 8);
        let (claim, _) = lease(&mut ledger, 1).expect("free");
        ledger.surrender(&Claim { actor: 2, ..claim });
        ledger.surrender(&Claim { attempt: 9, ..claim });
        assert_eq!(ledger.leases_of(1), 1);
        ledger.surrender(&claim);
        assert_eq!(ledger.leases_of(1), 0);
        assert_eq!(lease(&mut ledger, 2).map(|(claim, _)| (claim.work, claim.attempt)), Some((claim.work, 2)));
    }
}
