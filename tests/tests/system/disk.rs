//! What a learner finds on disk after a bad day: it repairs what can be repaired, and refuses the rest by name.

use crate::determinism::{EPISODES, undisturbed};
use herd_tests::patience::{LONG, SHORT};
use herd_tests::{Process, Run, damage};
use std::fs;

/// A run whose learner died in the middle, with no checkpoint but those every `every` episodes.
fn cut_short(every: u64, commits: u64) -> (Run, Process) {
    let run = Run::new(EPISODES).with(&format!("history.checkpoint_episodes={every}"));
    let mut learner = run.learner();
    let actor = run.actor();
    run.wait_for_commits(commits);
    learner.kill();
    run.assert_midway();
    (run, actor)
}

/// The run goes on to the bits of a run that nothing happened to.
#[track_caller]
fn recovers(run: &Run, actor: Process) {
    run.learner().wait(LONG).expect(0, &[]);
    actor.wait(SHORT).expect(0, &[]);
    assert_eq!(run.episodes(), (0..EPISODES).collect::<Vec<_>>());
    assert_eq!(run.fingerprint(), *undisturbed());
}

#[test]
fn a_torn_journal_record_is_run_again() {
    let (run, actor) = cut_short(1000, 6);
    damage::truncate(&damage::newest(&run.dir().join("journal")), 7);
    recovers(&run, actor);
}

#[test]
fn lost_metrics_are_written_again() {
    let (run, actor) = cut_short(1000, 6);
    fs::remove_file(run.dir().join("metrics.jsonl")).expect("it was there");
    recovers(&run, actor);
}

#[test]
fn a_damaged_checkpoint_gives_way_to_the_one_before() {
    let (run, actor) = cut_short(3, 9);
    let checkpoints = run.dir().join("checkpoints");
    assert!(damage::files(&checkpoints).len() > 1, "there is no other to fall back to");
    damage::garble_the_middle(&damage::newest(&checkpoints));
    recovers(&run, actor);
}

#[test]
fn without_any_checkpoint_the_journal_is_enough() {
    let (run, actor) = cut_short(3, 9);
    let checkpoints = run.dir().join("checkpoints");
    for file in damage::files(&checkpoints) {
        fs::remove_file(file).expect("it was there");
    }
    recovers(&run, actor);
}

#[test]
fn damage_within_the_journal_is_refused_with_its_place() {
    let (run, _actor) = cut_short(1000, 6);
    let journal = damage::newest(&run.dir().join("journal"));
    damage::garble_the_middle(&journal);
    let before = fs::read(&journal).expect("it is there");
    let name = journal.file_name().and_then(|name| name.to_str()).expect("plain name");
    let refused = run.learner().wait(SHORT);
    assert_ne!(refused.code, Some(0), "{}", refused.told());
    for word in [name, "damaged at byte"] {
        assert!(refused.stderr.contains(word), "no {word}: {}", refused.told());
    }
    assert_eq!(fs::read(&journal).expect("it is there"), before, "a learner that refuses a journal must not change it");
}

#[test]
fn a_directory_that_holds_something_else_is_refused() {
    let run = Run::new(4);
    fs::create_dir(run.dir()).expect("it can be made");
    fs::write(run.dir().join("thesis.tex"), "years of work").expect("it can be written");
    run.train(1).wait(SHORT).expect(78, &["thesis.tex"]);
    run.learner().wait(SHORT).expect(78, &["thesis.tex"]);
    assert_eq!(fs::read_to_string(run.dir().join("thesis.tex")).expect("still there"), "years of work");
}

#[test]
fn a_directory_of_another_run_is_refused_by_the_keys_that_differ() {
    let run = Run::new(2);
    run.train(1).wait(LONG).expect(0, &[]);
    let (before, run) = (run.fingerprint(), run.to(4).with("seed=99"));
    run.train(1).wait(SHORT).expect(78, &["seed", "7", "99"]);
    run.learner().wait(SHORT).expect(78, &["seed", "7", "99"]);
    assert_eq!(run.fingerprint(), before);
}
