//! Measuring how far a learner goes, small.

use herd_tests::Run;
use herd_tests::patience::LONG;
use serde_json::Value;
use std::fs;

#[test]
fn scale_measures_counts_and_names_the_bottleneck() {
    let run = Run::new(1);
    let directory = run.dir();
    let words = ["scale", "--synthetic", "--actors", "1,3", "--robots", "2", "--secs", "1", "--warmup", "0.3"];
    let mut command = run.herd(&words);
    // Small networks: this looks at counts, not at speed.
    command.args(["--decisions", "20", "--set", "ddpg.hidden=[16]", "--run-dir"]).arg(&directory);
    let measured = run.spawn("scale", &mut command).wait(LONG).expect(0, &[]);
    for word in ["transitions/s", "commit p50/p99", "broadcast p50/p99", "1 actors: ", "3 actors: "] {
        assert!(measured.stdout.contains(word), "no {word} in {}", measured.told());
    }
    assert!(fs::read_to_string(directory.join("scale.svg")).expect("a plot").starts_with("<svg"));
    let json = fs::read_to_string(directory.join("scale.json")).expect("figures");
    let json: Value = serde_json::from_str(&json).expect("JSON");
    let points = json["points"].as_array().expect("a list of points");
    assert_eq!(points.iter().map(|point| point["actors"].as_u64()).collect::<Vec<_>>(), [Some(1), Some(3)]);
    for point in points {
        let (committed, acknowledged) = (&point["committed"], &point["acknowledged"]);
        assert!(committed["transitions"].as_u64() > Some(0), "{point}");
        for what in ["transitions", "episodes", "refused"] {
            assert_eq!(committed[what], acknowledged[what], "{what} of {point}");
        }
        assert_eq!(committed["transitions"].as_u64(), committed["episodes"].as_u64().map(|n| 20 * n), "{point}");
        for figure in ["/transitions_per_sec", "/received_bytes_per_sec", "/commit/p50_ms", "/broadcast/p99_ms"] {
            assert!(point.pointer(figure).and_then(Value::as_f64) > Some(0.0), "{figure} of {point}");
        }
        assert_eq!(point["updates_per_sec"].as_f64(), Some(0.0), "{point}");
        // 56 → 16 → 4 numbers of four bytes with their biases, and names.
        assert!(point["policy_bytes"].as_u64() > Some(4 * (57 * 16 + 17 * 4)), "{point}");
        assert!(point["lost"].is_null(), "{point}");
    }
    assert!(!directory.join("actors-1").exists(), "the run of a point is removed");
    run.assert_no_orphans();
}

#[test]
fn points_with_equal_numbers_are_kept_apart() {
    let run = Run::new(1);
    let directory = run.dir();
    let words = ["scale", "--synthetic", "--actors", "1,1", "--keep", "--secs", "0.3", "--warmup", "0.1"];
    let mut command = run.herd(&words);
    command.args(["--set", "ddpg.hidden=[16]", "--run-dir"]).arg(&directory);
    let measured = run.spawn("scale", &mut command).wait(LONG).expect(0, &[]);
    assert!(measured.stdout.contains("\n1 #2 "), "{}", measured.told());
    for kept in ["actors-1", "actors-1-2"] {
        assert!(directory.join(kept).join("journal").exists(), "{kept} is kept");
    }
}

#[test]
fn the_model_needs_no_run() {
    let told = Run::new(1).ask(&["scale", "--model"]).expect(0, &[]);
    assert!(told.stdout.contains("100,000") && told.stdout.contains("bottleneck"), "{}", told.told());
}
