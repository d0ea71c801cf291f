//! The robot in another simulator: exported, driven, and not far from ours.

use crate::skipped;
use herd_tests::herd;
use std::path::Path;
use std::process::Command;

#[test]
fn mujoco_moves_as_we_do() {
    let test = "mujoco_moves_as_we_do";
    let sim2sim = Path::new(env!("CARGO_MANIFEST_DIR")).join("sim2sim");
    let own = sim2sim.join(".venv/bin/python");
    let python = if own.exists() { own.as_path() } else { Path::new("python3") };
    match Command::new(python).args(["-c", "import mujoco, numpy"]).output() {
        Err(error) => return skipped(test, &format!("{}: {error}", python.display())),
        Ok(output) if !output.status.success() => {
            return skipped(test, "python3 has no mujoco and numpy: tests/sim2sim/install.sh");
        }
        Ok(_) => {}
    }
    let compare = sim2sim.join("compare.py");
    let mut compare_quickly = Command::new(python);
    compare_quickly.arg(compare).arg("--quick").env("HERD", herd());
    let output = compare_quickly.output().expect("python starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one line of JSON");
    let number = |path: &str| found.pointer(path).and_then(serde_json::Value::as_f64).expect("a number");
    // Half a second of torques without feedback, from a lift-off and from the middle of a swing.
    assert!(number("/open_loop/worst_max_rad") < 0.05, "{found}");
    for simulator in ["herd", "mujoco"] {
        assert_eq!(found[simulator]["ending"], "timed_out", "{found}");
        assert!((number(&format!("/{simulator}/load")) - 1.0).abs() < 0.02, "{found}");
    }
    let speeds = [number("/herd/mean_speed_mps"), number("/mujoco/mean_speed_mps")];
    assert!((speeds[0] - speeds[1]).abs() < 0.02, "{found}");
}
