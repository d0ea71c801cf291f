//! `herd train`: a run from nothing to complete, again, and further.

use herd_common::config::Config;
use herd_tests::{Run, patience::LONG};
use std::fs;

#[test]
fn a_run_completes_and_leaves_everything_where_it_belongs() {
    let run = Run::new(10);
    let trained = run.train(2).wait(LONG).expect(0, &[]);
    run.assert_no_orphans();
    for name in ["config.toml", "policy.safetensors", "metrics.jsonl", "evaluations.jsonl"] {
        assert!(run.dir().join(name).is_file(), "{name} is missing: {}", trained.told());
    }
    for name in ["journal", "checkpoints"] {
        let mut entries = fs::read_dir(run.dir().join(name)).expect("a directory");
        assert!(entries.next().is_some(), "{name} is empty");
    }
    assert!(!run.dir().join("address").exists(), "the address outlives the learner");
    assert_eq!(run.episodes(), (0..10).collect::<Vec<_>>());
    let last = run.metrics().pop().expect("ten lines");
    let of = |key: &str| last[key].as_u64().expect("a count");
    let config = Config::load(Some(&run.dir().join("config.toml")), &[]).expect("what was used");
    assert_eq!(of("updates"), of("transitions") - config.ddpg.warmup_transitions, "one update a transition");
    assert!(of("updates") > 0, "nothing was learned: {last}");
    assert!(last["critic_loss"].as_f64().is_some_and(f64::is_finite), "no loss: {last}");
}

#[test]
fn a_complete_run_says_so_and_can_be_continued() {
    let run = Run::new(6);
    run.train(1).wait(LONG).expect(0, &[]);
    let (first, before) = (run.fingerprint(), run.metrics());

    let again = run.train(1).wait(LONG).expect(0, &[]);
    let said = format!("{}{}", again.stdout, again.stderr);
    assert!(said.contains("complete"), "it does not say that the run is complete: {}", again.told());
    assert_eq!(run.fingerprint(), first, "nothing was left to do, but something was done");

    let run = run.to(10);
    run.train(1).wait(LONG).expect(0, &[]);
    assert_eq!(run.episodes(), (0..10).collect::<Vec<_>>());
    assert_eq!(run.metrics()[..6], before, "continuing changed the past");
    assert_ne!(run.fingerprint().policy, first.policy, "four more episodes taught nothing");
}

#[test]
fn a_run_may_be_continued_without_repeating_its_configuration() {
    let run = Run::new(4);
    run.train(1).wait(LONG).expect(0, &[]);
    let directory = run.dir();
    let words = ["train", "--actors", "1", "--run-dir", directory.to_str().expect("plain name"), "--episodes", "6"];
    run.spawn("train", &mut run.herd(&words)).wait(LONG).expect(0, &[]);
    assert_eq!(run.episodes(), (0..6).collect::<Vec<_>>());
}

#[test]
fn another_seed_gives_another_run() {
    let (one, other) = (Run::new(4), Run::new(4).with("seed=8"));
    one.train(1).wait(LONG).expect(0, &[]);
    other.train(1).wait(LONG).expect(0, &[]);
    assert_ne!(one.fingerprint().metrics, other.fingerprint().metrics);
    assert_ne!(one.fingerprint().policy, other.fingerprint().policy);
}
