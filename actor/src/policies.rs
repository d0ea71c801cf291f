//! The policies an actor holds: the newest as they are published, older ones when a lease asks for one.
//!
//! One connection's worth: a learner that restarts may number its policies anew, so nothing is kept across streams.

use herd_common::caps;
use herd_common::config::Config;
use herd_common::policy::Policy;
use herd_common::spaces::Task;
use herd_common::work::Order;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

/// What an order needs to be run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Need {
    /// Nothing: it acts at random or with a constant gait.
    Nothing,
    /// This policy.
    Policy(Arc<Policy>),
    /// A policy of this version, which is not here.
    Missing(u64),
}

/// Policies by version.
#[derive(Debug, Default)]
pub(crate) struct Shelf {
    held: BTreeMap<u64, Arc<Policy>>,
    /// Versions in order of arrival, oldest first: what goes when the shelf is full.
    arrived: VecDeque<u64>,
    requested: BTreeSet<u64>,
    /// Newest version seen.
    newest: u64,
}

impl Shelf {
    /// What `order` needs under `config`.
    pub(crate) fn need(&self, order: &Order, config: &Config) -> Need {
        if order.random || config.task.kind == Task::Constant {
            return Need::Nothing;
        }
        self.held
            .get(&order.policy_version)
            .map_or(Need::Missing(order.policy_version), |policy| Need::Policy(policy.clone()))
    }

    /// True when `version` has not been asked for yet; it counts as asked for from here on.
    pub(crate) fn request(&mut self, version: u64) -> bool {
        self.requested.insert(version)
    }

    /// Newest version seen.
    pub(crate) fn newest(&self) -> u64 {
        self.newest
    }

    /// Adds a policy, after a look at whether it fits the task. Returns one that had to go, if nobody else has it.
    pub(crate) fn add(&mut self, policy: Policy, config: &Config, task_hash: &str) -> Result<Option<Policy>, String> {
        policy.expect_task(task_hash).map_err(|e| e.to_string())?;
        let (found, expected) = (
            (policy.observation_dim(), policy.action_dim()),
            (config.task.kind.observation_dim(), config.task.kind.action_dim()),
        );
        if found != expected {
            return Err(format!("policy takes and gives {found:?} numbers, expected {expected:?}"));
        }
        let version = policy.provenance.version;
        self.newest = self.newest.max(version);
        self.requested.remove(&version);
        let replaced = self.held.insert(version, Arc::new(policy));
        if replaced.is_none() {
            self.arrived.push_back(version);
        }
        let over = self.arrived.len() > caps::POLICIES_CACHED;
        let oldest = over.then(|| self.arrived.pop_front()).flatten();
        Ok(oldest.and_then(|oldest| self.held.remove(&oldest)).or(replaced).and_then(Arc::into_inner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{order, policy};

    fn wants(version: u64) -> Order {
        Order { random: false, policy_version: version, ..order(0) }
    }

    #[test]
    fn needs_are_met_once_the_policy_is_there() {
        let (mut shelf, config) = (Shelf::default(), Config::default());
        assert_eq!(shelf.need(&order(0), &config), Need::Nothing);
        assert_eq!(shelf.need(&wants(7), &config), Need::Missing(7));
        assert!(shelf.request(7));
        assert!(!shelf.request(7), "asked for twice");
        shelf.add(policy(&config, 7), &config, &config.task_hash()).expect("fits");
        assert!(matches!(shelf.need(&wants(7), &config), Need::Policy(p) if p.provenance.version == 7));
        assert_eq!(shelf.newest(), 7);
    }

    #[test]
    fn the_shelf_is_bounded_and_keeps_what_came_last() {
        let (mut shelf, config) = (Shelf::default(), Config::default());
        let hash = config.task_hash();
        for version in 100..100 + caps::POLICIES_CACHED as u64 {
            assert_eq!(shelf.add(policy(&config, version), &config, &hash).expect("fits"), None);
        }
        let unused = shelf.add(policy(&config, 5), &config, &hash).expect("fits").expect("nobody acts with it");
        assert_eq!(unused.provenance.version, 100);
        assert!(matches!(shelf.need(&wants(5), &config), Need::Policy(_)), "an old one that was asked for stays");
        assert_eq!(shelf.need(&wants(100), &config), Need::Missing(100));
        assert_eq!(shelf.held.len(), caps::POLICIES_CACHED);
        let in_use = shelf.need(&wants(101), &config);
        assert_eq!(shelf.add(policy(&config, 6), &config, &hash).expect("fits"), None, "a robot acts with it");
        assert!(matches!(in_use, Need::Policy(policy) if policy.provenance.version == 101));
        let unused = shelf.add(policy(&config, 6), &config, &hash).expect("fits").expect("came twice");
        assert_eq!((unused.provenance.version, shelf.held.len()), (6, caps::POLICIES_CACHED));
    }

    #[test]
    fn a_policy_of_another_task_is_refused() {
        let (mut shelf, config) = (Shelf::default(), Config::default());
        let error = shelf.add(policy(&config, 1), &config, "0000").expect_err("refused");
        assert!(error.contains("trained for task"), "{error}");
        let torque = config.overridden(&["task.kind=torque".into()]).expect("valid");
        let error = shelf.add(policy(&config, 1), &torque, &config.task_hash()).expect_err("refused");
        assert!(error.contains("(56, 4) numbers, expected (56, 12)"), "{error}");
        let command = config.overridden(&["task.kind=command".into()]).expect("valid");
        let error = shelf.add(policy(&config, 1), &command, &config.task_hash()).expect_err("refused");
        assert!(error.contains("(56, 4) numbers, expected (59, 4)"), "{error}");
        shelf.add(policy(&command, 1), &command, &command.task_hash()).expect("fits");
    }
}
