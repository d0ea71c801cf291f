//! Learner and actors started one by one, in any order, as on several machines.

use herd_tests::Run;
use herd_tests::patience::{LONG, SHORT};
use std::collections::BTreeSet;

const ENDLESS: u64 = 100_000;

#[test]
fn a_learner_and_two_actors_train_together() {
    let run = Run::new(12);
    let (learner, one, other) = (run.learner(), run.actor(), run.actor());
    learner.wait(LONG).expect(0, &[]);
    one.wait(SHORT).expect(0, &[]);
    other.wait(SHORT).expect(0, &[]);
    assert_eq!(run.episodes(), (0..12).collect::<Vec<_>>());
}

#[test]
fn an_actor_that_is_early_waits_and_says_so() {
    let run = Run::new(4);
    let address = run.dir().join("address");
    let mut actor = run.actor();
    actor.wait_until_it_says(SHORT, &["WARN", address.to_str().expect("plain name")]);
    assert!(actor.is_running(), "it gave up");
    run.learner().wait(LONG).expect(0, &[]);
    actor.wait(SHORT).expect(0, &[]);
    assert_eq!(run.committed(), 4);
}

#[test]
fn a_learner_that_comes_back_on_its_port_gets_its_actors_back() {
    let run = Run::new(ENDLESS);
    let learner = run.learner();
    let address = run.address();
    let (mut one, mut other) = (run.actor_of(&address), run.actor_of(&address));
    run.wait_for_commits(2);
    run.ask(&["stop", "--learner", &address]).expect(0, &[]);
    learner.wait(SHORT).expect(0, &[]);
    for actor in [&mut one, &mut other] {
        actor.wait_until_it_says(SHORT, &["WARN", &address]);
        assert!(actor.is_running(), "it gave up");
    }

    let before = run.committed();
    let mut again = run.learner_on(&address);
    let status = run.status_when("both actors are back", |status| status["actors"].as_array().map(Vec::len) == Some(2));
    assert_eq!(status["epoch"], 2, "this is its second learner: {status}");
    run.wait_for_commits(before + 2);
    assert!(again.is_running());
}

#[test]
fn a_second_learner_on_the_same_run_ends_the_first() {
    let run = Run::new(ENDLESS);
    let first = run.learner();
    let _actor = run.actor();
    run.wait_for_commits(2);
    let _second = run.learner();
    let first = first.wait(LONG);
    assert_ne!(first.code, Some(0), "{}", first.told());
    assert!(first.stderr.contains("another learner"), "{}", first.told());
    let before = run.committed();
    run.wait_for_commits(before + 2);
}

#[test]
fn throughput_order_commits_every_episode_once() {
    let run = Run::new(16).with("schedule.order=throughput");
    let (learner, one, other) = (run.learner(), run.actor(), run.actor());
    learner.wait(LONG).expect(0, &[]);
    one.wait(SHORT).expect(0, &[]);
    other.wait(SHORT).expect(0, &[]);
    let episodes = run.episodes();
    assert_eq!(episodes.len(), 16, "some twice, or some lost: {episodes:?}");
    assert_eq!(episodes.into_iter().collect::<BTreeSet<_>>(), (0..16).collect());
}

#[test]
fn throughput_order_survives_a_killed_learner() {
    let run = Run::new(16).with("schedule.order=throughput");
    let mut learner = run.learner();
    let (one, other) = (run.actor(), run.actor());
    run.wait_for_commits(5);
    learner.kill();
    run.assert_midway();
    run.learner().wait(LONG).expect(0, &[]);
    one.wait(SHORT).expect(0, &[]);
    other.wait(SHORT).expect(0, &[]);
    let episodes = run.episodes();
    assert_eq!(episodes.len(), 16, "some twice, or some lost: {episodes:?}");
    assert_eq!(episodes.into_iter().collect::<BTreeSet<_>>(), (0..16).collect());
}

#[test]
fn an_actor_that_insists_on_another_task_is_told_both_sides() {
    let run = Run::new(4);
    let _learner = run.learner();
    let address = run.address();
    let words = ["actor", "--learner", &address, "--set", "task.kind=torque"];
    let actor = run.spawn("actor", &mut run.herd(&words)).wait(SHORT);
    actor.expect(78, &["task mismatch", "torque", "gait"]);
}
