//! `herd reproduce`: from nothing to a report, and again without doing anything twice.

use herd_tests::{Finished, Run, patience::LONG};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Small networks and short episodes: the whole in seconds.
const TINY: [&str; 9] = [
    "task.episode_secs=0.5",
    "task.settle_secs=0.1",
    "ddpg.hidden=[16, 16]",
    "ddpg.batch_size=8",
    "ddpg.warmup_transitions=20",
    "exploration.warmup_episodes=2",
    "evaluation.every_episodes=0",
    "history.durability=memory",
    "schedule.lag=4",
];
/// Every figure, without its ending.
const FIGURES: [&str; 6] = [
    "figure-3-swing",
    "figure-4-gaits",
    "figure-5-centre-of-mass",
    "figure-6-roll-pitch",
    "figure-7-return",
    "beyond-the-paper",
];

fn reproduce(run: &Run, more: &[&str]) -> Finished {
    let directory = run.dir();
    let counts = ["--episodes", "24", "--rough-episodes", "10", "--evaluation-episodes", "2", "--search-episodes", "6"];
    let mut words = vec!["reproduce", "--run-dir", directory.to_str().expect("plain name"), "--actors", "1"];
    words.extend(["--seeds", "1,2"]);
    words.extend(counts);
    words.extend(TINY.iter().flat_map(|set| ["--set", *set]));
    words.extend(more);
    run.spawn("reproduce", &mut run.herd(&words)).wait(LONG)
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// When each file below `directory` was written.
fn times(directory: &Path) -> Vec<(String, std::time::SystemTime)> {
    let files = fs::read_dir(directory).expect("a directory").flatten();
    let mut times: Vec<_> = files
        .map(|file| (file.file_name().to_string_lossy().into_owned(), file.metadata().and_then(|m| m.modified())))
        .map(|(name, time)| (name, time.expect("files have a time")))
        .collect();
    times.sort();
    times
}

#[test]
fn a_reproduction_ends_in_a_report_and_is_not_done_twice() {
    let run = Run::new(0);
    let first = reproduce(&run, &[]).expect(0, &["write the report"]);
    run.assert_no_orphans();
    let report = run.dir().join("report");
    let page = read(&report.join("index.html"));
    assert!(!page.contains("NaN") && page.matches("<svg xmlns").count() == FIGURES.len(), "{}", first.told());
    for name in FIGURES {
        assert!(read(&report.join(format!("{name}.svg"))).starts_with("<svg"), "{name}");
        let png = fs::read(report.join(format!("{name}.png"))).expect("a picture");
        assert!(png.starts_with(b"\x89PNG") && png.len() > 5000, "{name}: {} bytes", png.len());
    }
    let numbers: Value = serde_json::from_str(&read(&report.join("report.json"))).expect("JSON");
    assert_eq!(numbers["claims"].as_array().map(Vec::len), Some(10));
    for seed in 0..2 {
        let transitions = |group: &str| numbers[group][seed]["cost"]["transitions"].as_u64().expect("a count");
        let (gait, torque) = (transitions("group_1"), transitions("group_0"));
        assert!(gait >= 24 && torque >= gait, "Group_0 has {torque} transitions, Group_1 {gait}");
        assert_eq!(numbers["group_1"][seed]["evaluation"]["returns"].as_array().map(Vec::len), Some(2));
    }
    let searched = numbers["constant"]["search"]["episodes"].as_u64().expect("a count");
    assert!((1..=6).contains(&searched), "{searched} episodes of 6");

    assert!(numbers["commit"].as_str().is_some_and(|commit| page.contains(commit)), "{}", numbers["commit"]);
    let against = numbers["against"].as_array().expect("both places");
    let places: Vec<_> = against.iter().map(|one| one["place"].as_str()).collect();
    assert_eq!(places, [Some("flat"), Some("rough")]);
    for one in against {
        assert_eq!(one["contests"].as_array().map(Vec::len), Some(2));
        assert!(page.contains(one["words"].as_str().expect("a verdict")), "{one}");
    }
    let (search, trained) = (&numbers["rough"]["constant"]["search"], &numbers["rough"]["group_1"]);
    let secs = |value: &Value| value.as_f64().expect("a time");
    let longest = (0..2).map(|seed| secs(&trained[seed]["cost"]["simulated_secs"])).fold(0.0, f64::max);
    assert!(secs(&search["simulated_secs"]) <= longest, "{search}");

    let before = times(&run.dir().join("results"));
    let again = reproduce(&run, &[]).expect(0, &["done before"]);
    assert!(!again.told().contains("transitions/s"), "something was trained again: {}", again.told());
    assert_eq!(times(&run.dir().join("results")), before);
    let repeated: Value = serde_json::from_str(&read(&report.join("report.json"))).expect("JSON");
    assert_eq!(repeated, numbers, "the same results give another report");

    reproduce(&run, &["--set", "robot.trunk_mass_kg=9.0"]).expect(78, &["robot.trunk_mass_kg", "9.0", "12.0"]);
}
