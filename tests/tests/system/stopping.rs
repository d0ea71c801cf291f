//! How a run ends early: on Ctrl-C, on SIGTERM, and when its head is cut off.

use herd_tests::Run;
use herd_tests::patience::{LONG, SHORT};
use rustix::process::Signal;
use std::time::Duration;

/// What a user waits at most for a run that they asked to stop.
const DRAIN: Duration = Duration::from_secs(20);
/// More episodes than any test waits for.
const ENDLESS: u64 = 100_000;

#[test]
fn a_killed_train_leaves_no_orphan() {
    let run = Run::new(ENDLESS);
    let mut train = run.train(2);
    run.wait_for_commits(1);
    run.wait_for(2, "actor");
    train.kill();
    run.assert_no_orphans();
}

#[test]
fn ctrl_c_saves_the_run_and_the_next_train_goes_on_from_there() {
    let run = Run::new(ENDLESS);
    let train = run.train(2);
    run.wait_for_commits(4);
    train.signal_group(Signal::INT);
    train.wait(DRAIN).expect(0, &[]);
    run.assert_no_orphans();
    let before = run.metrics();
    let checkpoint = herd_tests::damage::newest(&run.dir().join("checkpoints"));
    assert!(checkpoint.is_file());

    let run = run.to(before.len() as u64 + 2);
    run.train(1).wait(LONG).expect(0, &[]);
    assert_eq!(run.metrics()[..before.len()], before, "the episodes before Ctrl-C are not the same");
    assert_eq!(run.committed(), before.len() as u64 + 2);
}

#[test]
fn a_learner_on_sigterm_saves_and_ends_with_success() {
    let run = Run::new(ENDLESS);
    let (learner, mut actor) = (run.learner(), run.actor());
    run.wait_for_commits(2);
    learner.signal(Signal::TERM);
    learner.wait(DRAIN).expect(0, &[]);
    assert!(!run.dir().join("address").exists(), "the address outlives the learner");
    assert!(actor.is_running(), "an actor outlives its learner: {}", actor.stderr());
    actor.signal(Signal::TERM);
    actor.wait(DRAIN).expect(0, &[]);
}

#[test]
fn a_run_stopped_over_the_wire_says_where_it_stands() {
    let run = Run::new(ENDLESS);
    let train = run.train(1);
    run.wait_for_commits(2);
    let directory = run.dir();
    let directory = directory.to_str().expect("plain name");
    run.ask(&["checkpoint", "--run-dir", directory]).expect(0, &[]);
    run.ask(&["stop", "--run-dir", directory]).expect(0, &[]);
    train.wait(SHORT).expect(0, &[]);
    run.assert_no_orphans();
    assert!(run.committed() >= 2);
}
