//! Tests of the device's trainer against the CPU's: on the host in every build, on a GPU in one with the feature `cuda`.

use super::super::tests::*;
use super::super::{Ddpg, Error, Snapshot};
use super::*;
use herd_common::transition;

/// A build with the feature needs a GPU for these tests.
const DEVICE: Device = if cfg!(feature = "cuda") { Device::Cuda } else { Device::Host };

fn on_device(sets: &[&str]) -> OnDevice {
    OnDevice::new(&config(sets), DIMS, Seed::from_number(5), DEVICE).unwrap()
}

/// Every number of a snapshot, as bits.
fn bits(snapshot: &Snapshot) -> Vec<u32> {
    snapshot.records.iter().flat_map(|record| record.values.iter().map(|x| x.to_bits())).collect()
}

fn learn(ddpg: &mut OnDevice, replay: &Replay, updates: u64, most: u64) -> Vec<Update> {
    let mut found = Vec::new();
    while (found.len() as u64) < updates {
        found.extend(ddpg.learn(replay, most.min(updates - found.len() as u64)).unwrap());
    }
    found
}

/// Fails unless each tensor is within `tolerance` of its counterpart, relative to its largest number.
#[track_caller]
fn assert_alike(found: &Snapshot, expected: &Snapshot, tolerance: f32) {
    assert_eq!(found.counters, expected.counters);
    assert_eq!(found.records.len(), expected.records.len());
    for (found, expected) in found.records.iter().zip(&expected.records) {
        assert_eq!((&found.name, &found.shape), (&expected.name, &expected.shape));
        let scale = expected.values.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
        for (i, (f, e)) in found.values.iter().zip(&expected.values).enumerate() {
            assert!((f - e).abs() <= tolerance * scale, "{}[{i}] is {f}, the CPU's is {e} of {scale}", found.name);
        }
    }
}

#[track_caller]
fn assert_updates_alike(found: &[Update], expected: &[Update]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        let close = |a: f32, b: f32| (a - b).abs() <= 1e-4 * b.abs().max(1e-2);
        assert!(close(found.critic_loss, expected.critic_loss), "{found:?}, the CPU's is {expected:?}");
        assert!(close(found.mean_value, expected.mean_value), "{found:?}, the CPU's is {expected:?}");
        assert_eq!(found.actor_loss.is_some(), expected.actor_loss.is_some());
        assert!(close(found.actor_loss.unwrap_or(0.0), expected.actor_loss.unwrap_or(0.0)), "{found:?}, {expected:?}");
        assert!(!found.skipped && !expected.skipped);
    }
}

/// A clip that is small enough to bite, and a decay that is large enough.
const CLIPPED: [&str; 4] =
    ["ddpg.gradient_clip=0.05", "ddpg.critic_decay=5", "ddpg.actor_every=2", "ddpg.open_box=true"];

#[test]
fn updates_agree_with_those_of_the_cpu() {
    let replay = random_replay(300, DIMS);
    for sets in [PLAIN, TD3, PRIORITISED, CLIPPED] {
        for updates in [1, 2, 12] {
            let (mut cpu, mut device) = (learner(&sets), on_device(&sets));
            assert_eq!(bits(&device.save().unwrap()), bits(&cpu.save().unwrap()), "both start alike");
            let (expected, found) = (run(&mut cpu, &replay, updates), learn(&mut device, &replay, updates as u64, 5));
            assert_updates_alike(&found, &expected);
            assert_alike(&device.save().unwrap(), &cpu.save().unwrap(), 1e-4);
        }
    }
}

/// Sums over a minibatch in three parts, the last shorter than the others.
#[test]
fn sums_in_parts_agree_with_those_of_the_cpu() {
    let replay = random_replay(300, DIMS);
    for sets in [PLAIN, TD3] {
        let sets = [&sets[..], &["ddpg.batch_size=250"]].concat();
        let (mut cpu, mut device) = (learner(&sets), on_device(&sets));
        assert_updates_alike(&learn(&mut device, &replay, 4, 4), &run(&mut cpu, &replay, 4));
        assert_alike(&device.save().unwrap(), &cpu.save().unwrap(), 1e-4);
    }
}

#[test]
fn the_copy_of_a_memory_that_goes_round_is_the_memory() {
    for sets in [PLAIN, PRIORITISED] {
        let sets = [&sets[..], &["ddpg.replay_capacity=50"]].concat();
        let (mut cpu, mut device) = (learner(&sets), on_device(&sets));
        let (mut replay, mut rng) = (Replay::new(50, DIMS.observation, DIMS.action), Seed::from_number(8).rng());
        for _ in 0..10 {
            replay.push(&random_transitions(17, DIMS, &mut rng));
            assert_updates_alike(&learn(&mut device, &replay, 3, 3), &run(&mut cpu, &replay, 3));
        }
        assert_alike(&device.save().unwrap(), &cpu.save().unwrap(), 1e-3);
    }
}

#[test]
fn updates_that_go_together_are_those_that_go_alone() {
    let replay = random_replay(300, DIMS);
    for sets in [PLAIN, TD3, CLIPPED] {
        let (mut alone, mut together) = (on_device(&sets), on_device(&sets));
        assert_eq!(together.learn(&replay, 13).unwrap().len(), 13, "all of them go together");
        learn(&mut alone, &replay, 13, 1);
        let (found, expected) = (learn(&mut together, &replay, 20, 20), learn(&mut alone, &replay, 20, 1));
        assert_eq!(found, expected);
        assert_eq!(together.save().unwrap(), alone.save().unwrap());
        assert_eq!(bits(&together.save().unwrap()), bits(&alone.save().unwrap()));
    }
    let mut prioritised = on_device(&PRIORITISED);
    assert_eq!(prioritised.learn(&replay, 13).unwrap().len(), 1, "each draw needs the last one's errors");
    let mut endless = on_device(&PLAIN);
    assert_eq!(endless.learn(&replay, u64::MAX).unwrap().len(), caps::UPDATES_PER_ROUND);
}

/// Batches for which a GPU takes small tiles and medium ones. Gradients are told by the means of a first step. Of so many
/// ReLUs one or the other is at its bend, where the last bit decides whether a transition counts.
#[cfg(feature = "cuda")]
#[test]
fn gradients_of_large_minibatches_agree_with_those_of_the_cpu() {
    let dims = Dims { observation: 56, action: 4 };
    let replay = random_replay(5000, dims);
    for batch_size in [250, 1024, 4096] {
        let batch_size = format!("ddpg.batch_size={batch_size}");
        let sets = ["ddpg.hidden=[512, 256]", "ddpg.twin_critic=true", "ddpg.actor_every=1", &batch_size];
        let (config, seed) = (config(&sets), Seed::from_number(5));
        let mut cpu = Ddpg::new(&config, dims, seed).unwrap();
        let mut device = OnDevice::new(&config, dims, seed, DEVICE).unwrap();
        assert_updates_alike(&learn(&mut device, &replay, 1, 1), &run(&mut cpu, &replay, 1));
        let [mut found, mut expected] = [device.save().unwrap(), cpu.save().unwrap()];
        for snapshot in [&mut found, &mut expected] {
            snapshot.records.retain(|record| record.name.contains("mean"));
        }
        assert_eq!(found.records.len(), 18, "{batch_size}");
        assert_alike(&found, &expected, 1e-3);
    }
}

#[test]
fn snapshots_pass_from_one_trainer_to_the_other() {
    let replay = random_replay(300, DIMS);
    for sets in [PLAIN, TD3, PRIORITISED] {
        let (mut cpu, mut device) = (learner(&sets), on_device(&sets));
        run(&mut cpu, &replay, 11);
        let snapshot = cpu.save().unwrap();
        device.load(&snapshot).unwrap();
        assert_eq!(device.save().unwrap(), snapshot);
        assert_eq!(device.policy_layers().unwrap(), cpu.policy_layers().unwrap());
        let (expected, found) = (run(&mut cpu, &replay, 3), learn(&mut device, &replay, 3, 3));
        assert_updates_alike(&found, &expected);
        assert_alike(&device.save().unwrap(), &cpu.save().unwrap(), 1e-4);

        let snapshot = device.save().unwrap();
        let mut resumed = on_device(&sets);
        resumed.load(&snapshot).unwrap();
        assert_eq!(learn(&mut resumed, &replay, 9, 4), learn(&mut device, &replay, 9, 9), "a loaded one goes on");
        assert_eq!(bits(&resumed.save().unwrap()), bits(&device.save().unwrap()));
        let mut other = learner(&sets);
        other.load(&snapshot).unwrap();
        assert_eq!(other.save().unwrap(), snapshot);
    }
    let error = on_device(&PLAIN).load(&learner(&TD3).save().unwrap()).unwrap_err().to_string();
    assert!(error.contains("expected no more tensors"), "{error}");
}

/// A memory of which this share of the transitions overflows the loss.
fn poisoned(good: usize, bad: usize) -> Replay {
    let n = good + bad;
    let mut replay = Replay::new(n, DIMS.observation, DIMS.action);
    replay.push(&transition::Batch {
        observation_dim: DIMS.observation,
        action_dim: DIMS.action,
        observations: (0..n * DIMS.observation).map(|i| (i as f32).sin()).collect(),
        actions: (0..n * DIMS.action).map(|i| (i as f32).cos()).collect(),
        rewards: (0..n).map(|i| if i < bad { 1e30 } else { 0.5 }).collect(),
        discounts: vec![0.9; n],
        next_observations: (0..n * DIMS.observation).map(|i| (i as f32 + 1.0).sin()).collect(),
    });
    replay
}

#[test]
fn a_poisoned_batch_changes_nothing_and_is_counted() {
    let mut device = on_device(&TD3);
    let good = random_replay(100, DIMS);
    learn(&mut device, &good, 4, 4);
    let before = device.save().unwrap();
    let found = device.learn(&poisoned(0, 10), 3).unwrap();
    assert_eq!(found.iter().map(|update| update.skipped).collect::<Vec<_>>(), [true; 3]);
    assert_eq!((device.updates(), device.skipped()), (7, 3));
    let after = device.save().unwrap();
    assert_eq!(bits(&after), bits(&before));
    assert_eq!((after.counters.critic_steps, after.counters.actor_steps), (4, 2), "a skipped step is none");
    assert!(!device.learn(&good, 1).unwrap()[0].skipped);

    let over = (0..).find_map(|_| device.learn(&poisoned(0, 10), 7).err()).expect("it ends");
    assert!(matches!(over, Error::Diverged { skipped: caps::SKIPPED_UPDATES, update: 107 }), "{over}");
}

#[test]
fn targets_that_are_no_numbers_change_nothing_here_either() {
    let mut device = on_device(&TD3);
    device.load(&with_a_target_that_is_no_number(device.save().unwrap())).unwrap();
    let before = device.save().unwrap();
    let found = device.learn(&random_replay(100, DIMS), 1).unwrap();
    assert!(found[0].skipped && found[0].critic_loss.is_nan(), "{found:?}");
    assert_eq!(bits(&device.save().unwrap()), bits(&before));
}

#[test]
fn updates_between_poisoned_ones_are_those_of_the_cpu() {
    // Of 16 draws from 200 transitions, 5 of them bad, two thirds are good throughout.
    let replay = poisoned(195, 5);
    for sets in [PLAIN, TD3] {
        let (mut cpu, mut alone, mut together) = (learner(&sets), on_device(&sets), on_device(&sets));
        let expected: Vec<bool> = run(&mut cpu, &replay, 30).iter().map(|update| update.skipped).collect();
        assert!(expected.contains(&true) && expected.contains(&false), "{expected:?}");
        let skipped = |updates: Vec<Update>| updates.iter().map(|update| update.skipped).collect::<Vec<_>>();
        assert_eq!(skipped(learn(&mut together, &replay, 30, 30)), expected);
        assert_eq!(skipped(learn(&mut alone, &replay, 30, 1)), expected);
        assert_eq!(bits(&together.save().unwrap()), bits(&alone.save().unwrap()));
        assert_alike(&together.save().unwrap(), &cpu.save().unwrap(), 1e-3);
    }
}

#[test]
fn both_algorithms_find_the_optimum_of_a_point_mass_here_too() {
    for sets in [PLAIN, TD3] {
        let config = point_mass_config(&sets);
        let (dims, seed) = (Dims { observation: 1, action: 1 }, Seed::from_number(12));
        let mut device = OnDevice::new(&config, dims, seed, DEVICE).unwrap();
        learn(&mut device, &point_mass(3000), 3000, 50);
        let new = || Ddpg::new(&config, dims, seed).unwrap();
        let mut found = new();
        found.load(&device.save().unwrap()).unwrap();
        assert_finds_the_optimum(&new(), &found, &sets);
    }
}

#[test]
fn memories_of_other_spaces_are_refused() {
    let mut device = on_device(&PLAIN);
    assert!(matches!(device.learn(&Replay::new(10, 5, 2), 1), Err(Error::EmptyReplay)));
    let other = random_replay(10, Dims { observation: 5, action: 3 });
    assert!(matches!(device.learn(&other, 1), Err(Error::Dims { found: 3, .. })));
}

#[test]
fn what_no_device_has_places_for_is_refused_before_it_is_allocated() {
    let config = config(&["ddpg.device=cuda", "ddpg.batch_size=65536", "ddpg.hidden=[8192, 8192]"]);
    for checked in [
        super::super::Learner::check(&config, DIMS),
        OnDevice::check(&config, DIMS, Device::Host),
        OnDevice::new(&config, DIMS, Seed::from_number(5), Device::Host).map(|_| ()),
    ] {
        let error = checked.unwrap_err();
        // Seven passes through two layers, four of them there and back: 22 · 65536 · 8192 numbers.
        assert!(matches!(error, Error::TooLarge { found } if found > 2 * caps::DEVICE_NUMBERS), "{error}");
        assert!(error.to_string().contains("`ddpg.batch_size` and `ddpg.hidden`"), "{error}");
    }
}

#[cfg(not(feature = "cuda"))]
#[test]
fn a_gpu_without_the_feature_is_refused_by_name() {
    let config = config(&["ddpg.device=cuda"]);
    let error = super::super::Learner::new(&config, DIMS, Seed::from_number(5)).unwrap_err();
    assert!(matches!(error, Error::NoCuda));
    assert!(super::super::Learner::check(&config, DIMS).unwrap_err().to_string().contains("feature `cuda`"));
}
