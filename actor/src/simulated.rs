//! The simulated robot as the worker sees it: an order in, an episode out.

use crate::env::{Env, Observation};
use crate::explore::{Exploration, explorer};
use crate::meter::Meter;
use crate::rollout::run_until;
use crate::worker::{Emit, Factory, PIECE, Robot};
use herd_common::episode::Outcome;
use herd_common::policy::Policy;
use herd_common::spaces::Task;
use herd_common::transition::{Batch, Transition};
use herd_common::work::{Order, Work};
use std::sync::Arc;

/// Makes simulated robots.
pub(crate) fn factory() -> Factory {
    Arc::new(|robot, config, meter| {
        let env = Env::new(config).with_timer(nanos);
        Box::new(Simulated { robot, env, task: config.task.kind, smoothing: config.exploration.sigma_smoothing, meter })
    })
}

struct Simulated {
    robot: usize,
    env: Env,
    task: Task,
    /// Share of the last decision's noise kept.
    smoothing: f64,
    meter: Arc<Meter>,
}

impl Simulated {
    fn exploration(&self, order: &Order) -> Exploration {
        if self.task == Task::Constant {
            Exploration::None
        } else if order.random {
            Exploration::Uniform
        } else if order.sigma > 0.0 {
            Exploration::Gaussian { sigma: f64::from(order.sigma), smoothing: self.smoothing }
        } else {
            Exploration::None
        }
    }
}

impl Robot for Simulated {
    fn run(&mut self, order: &Order, policy: Option<&Policy>, emit: &mut Emit<'_>) -> Option<Outcome> {
        let dim = self.task.action_dim();
        let mut explorer = explorer(self.exploration(order), order.seed);
        let mut act = |observation: &Observation| {
            let mut action = policy.map_or_else(|| vec![0.0; dim], |policy| policy.act(observation));
            explorer.apply(&mut action);
            action
        };
        let mut piece = Batch::new(self.task.dims());
        // An evaluation is not stored; its empty pieces still ask whether to go on.
        let stored = matches!(order.work, Work::Episode(_));
        let mut sink = |transition: Transition<'_>| {
            if stored {
                piece.push(transition);
            }
            let full = piece.len() >= PIECE;
            let empty = Batch::new(self.task.dims());
            emit(if full { std::mem::replace(&mut piece, empty) } else { empty })
        };
        let outcome = run_until(&mut self.env, order.seed, &mut act, &mut sink)?;
        if emit(piece).is_break() {
            return None;
        }
        self.meter.add_episode(self.robot, &outcome, self.env.qp_latency());
        Some(outcome)
    }
}

/// A clock for the solver, ns since the first look at it; what it measures goes into heartbeats alone.
fn nanos() -> u64 {
    use std::sync::OnceLock;
    use std::time::Instant;
    static START: OnceLock<Instant> = OnceLock::new();
    #[expect(clippy::disallowed_methods, reason = "the shell's clock, handed to the cores as a function")]
    let now = Instant::now();
    now.duration_since(*START.get_or_init(|| now)).as_nanos() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{order, policy};
    use herd_common::config::Config;
    use std::ops::ControlFlow;

    fn config(sets: &[&str]) -> Config {
        let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
        Config::default().overridden(&sets).expect("valid")
    }

    fn run(config: &Config, order: &Order, policy: Option<&Policy>) -> (Batch, Outcome) {
        let mut robot = factory()(0, config, Arc::default());
        let mut all = Batch::new(config.task.kind.dims());
        let mut emit = |piece: Batch| {
            all.append(&piece);
            ControlFlow::Continue(())
        };
        let outcome = robot.run(order, policy, &mut emit).expect("not broken off");
        (all, outcome)
    }

    #[test]
    fn an_order_says_it_all() {
        let config = config(&["task.episode_secs=0.6"]);
        let order = Order { random: false, sigma: 0.3, ..order(3) };
        let policy = policy(&config, 1);
        let (transitions, outcome) = run(&config, &order, Some(&policy));
        assert_eq!(run(&config, &order, Some(&policy)), (transitions.clone(), outcome));
        assert_eq!(transitions.len() as u64, outcome.decisions);
        transitions.validate().expect("what is sent is what the learner takes");
        let other = Order { seed: order.seed.child("other", 0), ..order };
        assert_ne!(run(&config, &other, Some(&policy)).0.actions, transitions.actions);
    }

    #[test]
    fn exploration_is_what_the_order_says() {
        let config = config(&["task.kind=torque", "task.episode_secs=0.3"]);
        let policy = policy(&config, 1);
        let still = Order { random: false, sigma: 0.0, ..order(1) };
        let (transitions, _) = run(&config, &still, Some(&policy));
        for i in 0..transitions.len() {
            assert_eq!(transitions.get(i).action, policy.act(transitions.get(i).observation));
        }
        let random = Order { random: true, ..still };
        assert_eq!(run(&config, &random, Some(&policy)), run(&config, &random, None), "the policy is not asked");
    }

    #[test]
    fn an_episode_that_nobody_wants_is_broken_off() {
        let mut robot = factory()(0, &config(&["task.episode_secs=5"]), Arc::default());
        assert_eq!(robot.run(&order(1), None, &mut |_| ControlFlow::Break(())), None);
    }
}
