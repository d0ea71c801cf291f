//! Runs of made-up episodes without actors: killed between a commit and the next checkpoint, and learned from by a
//! device's trainer: the host's, or a GPU's in a build with the feature `cuda`.

use super::Trainer;
use crate::ddpg::{Device, Learner, OnDevice};
use crate::history::epoch::Epoch;
use crate::history::record::{Committed, Record};
use crate::run_dir::RunDir;
use crate::shelf::Shelf;
use herd_common::config::Config;
use herd_common::episode::{Counts, Ending, Outcome, Reward};
use herd_common::seed::Seed;
use herd_common::spaces::{GAIT_ACTION_DIM, OBSERVATION_DIM, Task};
use herd_common::transition::{Batch, Transition};
use rand::RngExt;
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;
use tokio::sync::watch;

const TRANSITIONS: u64 = 40;

fn config(more: &[&str]) -> Config {
    let sets = ["ddpg.hidden=[32, 16]", "ddpg.batch_size=16", "ddpg.warmup_transitions=30", "ddpg.output_init=0.1"];
    let sets: Vec<String> = sets.iter().chain(more).map(ToString::to_string).collect();
    Config::default().overridden(&sets).unwrap()
}

fn restore(dir: &Path, config: &Config) -> Trainer {
    let config = config.clone();
    let (dir, (shelf, _)) = (RunDir::open(dir, &config).unwrap(), watch::channel(Arc::new(Shelf::default())));
    let epoch = Epoch::take(dir.root()).unwrap();
    Trainer::restore(config, dir, epoch, shelf).unwrap()
}

fn commit(episode: u64) -> Committed {
    let mut rng = Seed::from_number(episode).rng();
    let mut numbers = || -> Vec<f32> { (0..OBSERVATION_DIM).map(|_| rng.random_range(-1.0..1.0)).collect() };
    let mut transitions = Batch::new(Task::Gait.dims());
    for _ in 0..TRANSITIONS {
        let (observation, next_observation) = (numbers(), numbers());
        transitions.push(Transition {
            observation: &observation,
            action: &next_observation[..GAIT_ACTION_DIM],
            reward: observation[0],
            discount: 0.95,
            next_observation: &next_observation,
        });
    }
    let outcome = Outcome {
        ending: Ending::TimedOut,
        decisions: TRANSITIONS,
        seconds: 1.0,
        reward: Reward::default(),
        distance_m: 0.0,
        roll_variance: 0.0,
        pitch_variance: 0.0,
        counts: Counts::default(),
    };
    Committed { episode, version: 0, sigma: 0.25, outcome, transitions }
}

/// Takes these commits in and learns from them.
fn live(trainer: &mut Trainer, episodes: std::ops::Range<u64>) {
    for episode in episodes {
        begin(trainer, episode);
        trainer.finish_digest().unwrap();
    }
}

/// Commits an episode and begins to learn from it.
fn begin(trainer: &mut Trainer, episode: u64) {
    let committed = commit(episode);
    trainer.journal.append(&Record::Episode(committed.clone())).unwrap();
    trainer.keep().unwrap();
    trainer.ledger.recommit(episode);
    trainer.begin_digest(&committed, trainer.journal.position());
}

/// Every number that the learner consists of, as bits.
fn bits(trainer: &Trainer) -> Vec<(String, Vec<u32>)> {
    let records = trainer.ddpg.save().unwrap().records;
    records.into_iter().map(|r| (r.name, r.values.iter().map(|value| value.to_bits()).collect())).collect()
}

/// Runs five episodes in one go, then with a trainer that is killed while it learns from the fourth, two commits after
/// its checkpoint.
#[track_caller]
fn check_killed(more: &[&str]) {
    let config = config(more);
    let whole = TempDir::new().unwrap();
    let mut trainer = restore(whole.path(), &config);
    live(&mut trainer, 0..5);
    let expected = bits(&trainer);
    for updates in [0, 7, TRANSITIONS] {
        let dir = TempDir::new().unwrap();
        let mut trainer = restore(dir.path(), &config);
        live(&mut trainer, 0..2);
        trainer.save_checkpoint().unwrap();
        live(&mut trainer, 2..3);
        begin(&mut trainer, 3);
        (0..updates).for_each(|_| trainer.digest_more().unwrap());
        assert_eq!((trainer.version(), trainer.ddpg.updates()), (3, 3 * TRANSITIONS - 30 + updates));
        drop(trainer);

        let mut trainer = restore(dir.path(), &config);
        assert_eq!((trainer.version(), trainer.ddpg.updates()), (4, 4 * TRANSITIONS - 30));
        live(&mut trainer, 4..5);
        assert!(bits(&trainer) == expected, "{more:?}, killed after {updates} updates");
        assert_eq!(metrics(dir.path()), metrics(whole.path()), "{more:?}, killed after {updates} updates");
    }
}

#[test]
fn a_killed_run_goes_on_to_the_same_bits() {
    check_killed(&[]);
}

#[test]
fn a_killed_run_with_priorities_and_several_steps_goes_on_to_the_same_bits() {
    check_killed(&["ddpg.priority_alpha=0.6", "ddpg.n_step=3"]);
}

/// The lines of `metrics.jsonl`.
fn metrics(dir: &Path) -> Vec<serde_json::Value> {
    let text = std::fs::read_to_string(dir.join("metrics.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn a_run_on_a_device_is_the_run_but_for_its_last_bits() {
    let (cpu, device) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let config = config(&[]);
    let mut trainer = restore(cpu.path(), &config);
    live(&mut trainer, 0..4);
    trainer.save_checkpoint().unwrap();

    let mut trainer = restore(device.path(), &config);
    let seed = Seed::from_number(config.seed).child("learner", 0);
    let kind = if cfg!(feature = "cuda") { Device::Cuda } else { Device::Host };
    let on_device = OnDevice::new(&config.ddpg, Task::Gait.dims(), seed, kind).unwrap();
    trainer.ddpg = Learner::Device(Box::new(on_device));
    live(&mut trainer, 0..3);
    assert_eq!(trainer.ddpg.updates(), 3 * TRANSITIONS - 30);
    trainer.save_checkpoint().unwrap();
    drop(trainer);

    // The CPU's trainer goes on from the device's checkpoint.
    let mut trainer = restore(device.path(), &config);
    assert_eq!((trainer.version(), trainer.ddpg.updates()), (3, 3 * TRANSITIONS - 30));
    live(&mut trainer, 3..4);
    trainer.save_checkpoint().unwrap();

    let (expected, found) = (metrics(cpu.path()), metrics(device.path()));
    assert_eq!((expected.len(), found.len()), (4, 4));
    for (found, expected) in found.iter().zip(&expected) {
        assert_eq!(found["updates"], expected["updates"]);
        for loss in ["critic_loss", "actor_loss", "mean_value"] {
            let [found, expected] = [found, expected].map(|line| line[loss].as_f64().expect("a loss"));
            assert!((found - expected).abs() <= 1e-3 * expected.abs().max(1e-2), "{loss} {found}, {expected}");
        }
    }
}
