//! Equal seeds give equal bits: whoever runs the episodes, whoever dies when.

use herd_tests::patience::{LONG, SHORT};
use herd_tests::{Fingerprint, Run};
use std::sync::OnceLock;

/// Enough that a kill meets the run in its middle.
pub(crate) const EPISODES: u64 = 24;

/// What an undisturbed run with one actor leaves.
pub(crate) fn undisturbed() -> &'static Fingerprint {
    static ONCE: OnceLock<Fingerprint> = OnceLock::new();
    ONCE.get_or_init(|| {
        let run = Run::new(EPISODES);
        run.train(1).wait(LONG).expect(0, &[]);
        assert_eq!(run.episodes(), (0..EPISODES).collect::<Vec<_>>());
        run.fingerprint()
    })
}

#[test]
fn three_actors_give_the_bits_of_one() {
    let run = Run::new(EPISODES);
    run.train(3).wait(LONG).expect(0, &[]);
    assert_eq!(run.fingerprint(), *undisturbed());
}

#[test]
fn one_actor_with_three_robots_gives_the_bits_of_one() {
    let run = Run::new(EPISODES);
    let mut command = run.configured(&["train", "--actors", "1", "--robots", "3"]);
    run.spawn("train", &mut command).wait(LONG).expect(0, &[]);
    assert_eq!(run.fingerprint(), *undisturbed());
}

#[test]
fn actors_that_are_killed_change_no_bit() {
    // One alone has to be replaced, or the run would never end; of two the other may end it before.
    for actors in [1, 2] {
        let run = Run::new(EPISODES);
        let train = run.train(actors);
        for commits in [3, 9] {
            run.wait_for_commits(commits);
            let alive: Vec<_> = run.processes().into_iter().filter(|process| process.is_herd("actor")).collect();
            if let Some(actor) = alive.first() {
                actor.kill();
                run.assert_midway();
            }
        }
        train.wait(LONG).expect(0, &["died, starting it again"]);
        assert_eq!(run.fingerprint(), *undisturbed());
    }
}

#[test]
fn a_learner_that_is_killed_under_train_changes_no_bit() {
    let run = Run::new(EPISODES);
    let train = run.train(2);
    run.wait_for_commits(7);
    run.wait_for(1, "learner")[0].kill();
    run.assert_midway();
    train.wait(LONG).expect(0, &[]);
    run.assert_no_orphans();
    assert_eq!(run.fingerprint(), *undisturbed());
}

#[test]
fn a_learner_that_is_killed_twice_and_started_again_by_hand_changes_no_bit() {
    let run = Run::new(EPISODES);
    let mut learner = run.learner();
    let actor = run.actor();
    for commits in [5, 13] {
        run.wait_for_commits(commits);
        learner.kill();
        run.assert_midway();
        learner = run.learner();
    }
    learner.wait(LONG).expect(0, &[]);
    actor.wait(LONG).expect(0, &[]);
    assert_eq!(run.fingerprint(), *undisturbed());
}

#[test]
fn a_run_that_is_stopped_and_continued_keeps_its_bits() {
    let run = Run::new(EPISODES);
    let train = run.train(1);
    run.wait_for_commits(4);
    train.signal(rustix::process::Signal::TERM);
    train.wait(SHORT).expect(0, &[]);
    run.assert_midway();
    run.train(2).wait(LONG).expect(0, &[]);
    assert_eq!(run.fingerprint(), *undisturbed());
}

#[test]
fn memory_durability_gives_the_same_bits() {
    let run = Run::new(EPISODES).with("history.durability=memory").with("history.checkpoint_episodes=1000");
    run.train(2).wait(LONG).expect(0, &[]);
    assert_eq!(run.fingerprint(), *undisturbed());
}

#[test]
fn in_throughput_order_a_killed_learner_counts_every_episode_once() {
    let run = Run::new(EPISODES).with("schedule.order=throughput");
    let train = run.train(3);
    for commits in [5, 13] {
        run.wait_for_commits(commits);
        run.wait_for(1, "learner")[0].kill();
        run.assert_midway();
        run.wait_for(1, "learner");
    }
    train.wait(LONG).expect(0, &[]);
    let mut episodes = run.episodes();
    episodes.sort_unstable();
    assert_eq!(episodes, (0..EPISODES).collect::<Vec<_>>());
}
