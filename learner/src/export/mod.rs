//! From the learner's actor to the plain policy that leaves the learner.
//!
//! The policy has its own forward pass (`herd_common::policy`), with sums in another order than candle's; a test holds
//! the two within 1e-5. `onnx` is the same for other programs.

mod onnx;

pub use onnx::{Golden, golden, onnx};

use crate::ddpg::{self, Learner};
use herd_common::policy::{self, Policy, Provenance};

/// Why there is no policy to export.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A weight is not finite, or candle failed.
    #[error("export policy: {0}")]
    Learner(#[from] ddpg::Error),
    /// The layers make no policy.
    #[error("export policy: {0}")]
    Policy(#[from] policy::Error),
}

/// The current actor as a policy of this provenance; every number in it is finite.
pub fn policy(learner: &Learner, provenance: Provenance) -> Result<Policy, Error> {
    Ok(Policy::new(provenance, learner.policy_layers()?)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ddpg::Ddpg;
    use herd_common::config::Config;
    use herd_common::seed::Seed;
    use herd_common::spaces::Task;
    use rand::RngExt;

    #[test]
    fn the_policy_acts_as_the_network_does() {
        let sets = ["ddpg.output_init=0.1".to_owned()];
        let config = Config::default().overridden(&sets).expect("valid").ddpg;
        let ddpg = || Ddpg::new(&config, Task::Gait.dims(), Seed::from_number(1)).unwrap();
        let provenance = Provenance { version: 1, run: "run".into(), task_hash: "task".into() };
        let policy = policy(&Learner::Cpu(Box::new(ddpg())), provenance.clone()).unwrap();
        let ddpg = ddpg();
        assert_eq!(policy.provenance, provenance);
        let mut rng = Seed::from_number(2).rng();
        for _ in 0..20 {
            let observation: Vec<f32> = (0..56).map(|_| rng.random_range(-1.0..1.0)).collect();
            let (found, expected) = (policy.act(&observation), ddpg.act(&observation));
            assert_eq!(found.len(), 4);
            assert!(expected.iter().any(|a| a.abs() > 0.01), "an action of zeros tests nothing");
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).abs() <= 1e-5, "{found}, candle says {expected}");
            }
        }
    }
}
