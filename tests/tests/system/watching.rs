//! Asking a run how it goes, while it goes.

use herd_tests::Run;
use herd_tests::patience::SHORT;
use serde_json::Value;
use std::collections::BTreeSet;

const ENDLESS: u64 = 100_000;

fn actor_pids(status: &Value) -> BTreeSet<u64> {
    let rows = status["actors"].as_array().expect("status has a list of actors");
    rows.iter().map(|row| row["pid"].as_u64().expect("each has its process id")).collect()
}

#[test]
fn status_tells_how_training_goes() {
    let run = Run::new(ENDLESS);
    let _train = run.train(2);
    let status = run.status_when("both actors report and something is learned", |status| {
        let positive = |path: &str| status.pointer(path).and_then(Value::as_f64).is_some_and(|x| x > 0.0);
        let figures = ["/episodes", "/transitions", "/updates", "/policy_version", "/replay/len", "/qp/solves"];
        let rates = ["/rates/episodes", "/rates/transitions", "/rates/updates", "/qp/p50_micros"];
        actor_pids(status).len() == 2 && figures.iter().chain(&rates).all(|path| positive(path))
    });
    assert_eq!(status["phase"], "training", "{status}");
    assert_eq!(status["schedule"], "deterministic", "{status}");
    assert_eq!(status["durability"], "disk", "{status}");
    assert_eq!(status["episodes_target"], ENDLESS, "{status}");
    assert_eq!(status["epoch"], 1, "{status}");
    assert_eq!(status["replay"]["capacity"], 10_000, "{status}");
    assert!(status["eta_secs"].as_f64() > Some(0.0), "{status}");
    assert!(status["bottleneck"].as_str().is_some_and(|text| !text.is_empty()), "{status}");
    for row in status["actors"].as_array().expect("rows") {
        assert!(row["robots"].as_u64() > Some(0) && row["host"].as_str().is_some_and(|host| !host.is_empty()), "{row}");
    }
    assert_eq!(actor_pids(&status), run.wait_for(2, "actor").iter().map(|p| u64::from(p.pid)).collect());
}

#[test]
fn status_reads_well_without_json() {
    let run = Run::new(ENDLESS);
    let _train = run.train(1);
    run.wait_for_commits(2);
    run.status_when("the actor has joined", |status| actor_pids(status).len() == 1);
    let shown = run.ask(&["status", "--learner", &run.address()]).expect(0, &[]);
    let text = shown.stdout.to_lowercase();
    for word in ["episodes", "transitions", "updates", "return", "replay", "actor"] {
        assert!(text.contains(word), "no {word} in {}", shown.told());
    }
}

#[test]
fn the_row_of_a_killed_actor_goes_and_its_successor_gets_one() {
    let run = Run::new(ENDLESS);
    let _train = run.train(2);
    run.status_when("both actors have joined", |status| actor_pids(status).len() == 2);
    let dead = run.wait_for(2, "actor").swap_remove(0);
    dead.kill();
    let gone = |status: &Value| !actor_pids(status).contains(&u64::from(dead.pid));
    run.status_when("the dead actor's row goes", gone);
    run.status_when("another takes its place", |status| gone(status) && actor_pids(status).len() == 2);
}

#[test]
fn wait_ready_returns_when_the_learner_is() {
    let run = Run::new(ENDLESS);
    let directory = run.dir();
    let words = ["wait-ready", "--run-dir", directory.to_str().expect("plain name"), "--timeout", "30"];
    let mut waiting = run.spawn("wait-ready", &mut run.herd(&words));
    assert!(waiting.is_running(), "nobody is there yet, but it returned: {}", waiting.stderr());
    let _learner = run.learner();
    waiting.wait(SHORT).expect(0, &[]);
    assert!(run.status().is_some(), "ready, but no answer");
}
