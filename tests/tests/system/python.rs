//! A client in another language that knows the address and nothing else.

use crate::skipped;
use herd_tests::Run;
use herd_tests::patience::SHORT;
use std::process::Command;

#[test]
fn python_finds_its_way_by_reflection() {
    let test = "python_finds_its_way_by_reflection";
    match Command::new("python3").args(["-c", "import grpc, grpc_reflection"]).output() {
        Err(error) => return skipped(test, &format!("python3: {error}")),
        Ok(output) if !output.status.success() => {
            return skipped(test, "python3 has no grpcio and grpcio-reflection");
        }
        Ok(_) => {}
    }
    let run = Run::new(4);
    let _learner = run.learner();
    run.ask(&["wait-ready", "--learner", &run.address()]).expect(0, &[]);
    let mut python = Command::new("python3");
    python.args(["-c", include_str!("look_around.py"), &run.address()]);
    let found = run.spawn("python3", &mut python).wait(SHORT).expect(0, &[]);
    for line in ["service herd.v1.Training", "service herd.v1.Work", "health 1", "target 4 training"] {
        assert!(found.stdout.lines().any(|said| said == line), "no {line:?}: {}", found.told());
    }
}
