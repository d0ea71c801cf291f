//! What a training leaves to say: figures, where the policy is, what to try next.

use crate::out;
use crate::status::endings;
use crate::table::{count, duration, facts, percent};
use herd_common::status::Status;
use std::path::Path;

/// How a training ended.
pub(crate) struct Run {
    /// The last snapshot; none when the learner never answered.
    pub(crate) status: Option<Status>,
    /// Episodes committed.
    pub(crate) done: u64,
    /// Episodes the run is to have.
    pub(crate) target: u64,
}

/// Prints the summary.
pub(crate) fn tell(run_dir: &Path, run: &Run, json: bool) -> anyhow::Result<()> {
    if !json {
        return out::print(&text(run_dir, run));
    }
    out::json(&serde_json::json!({
        "complete": run.done >= run.target,
        "episodes": run.done,
        "episodes_target": run.target,
        "policy": run_dir.join("policy.safetensors"),
        "status": run.status,
    }))
}

/// What to say of a run that needs no training.
pub(crate) fn already_complete(run_dir: &Path, done: u64, target: u64) -> String {
    let dir = run_dir.display();
    format!(
        "the run in {dir} is complete: {} of {} episodes; --episodes with a higher number makes it longer\n{}",
        count(done),
        count(target),
        next(run_dir)
    )
}

fn text(run_dir: &Path, run: &Run) -> String {
    let state = if run.done >= run.target { "complete" } else { "stopped; the same command continues it" };
    let mut lines =
        vec![("run", state.to_owned()), ("episodes", format!("{} of {}", count(run.done), count(run.target)))];
    if let Some(s) = &run.status {
        let evaluation = s.returns.evaluation.map_or("none yet".to_owned(), |mean| format!("{mean:.1}"));
        lines.extend([
            ("transitions", count(s.transitions)),
            ("updates", count(s.updates)),
            ("wall time", duration(s.uptime_secs)),
            ("mean return of the last 100", format!("{:.1}", s.returns.mean)),
            ("best return", format!("{:.1}", s.returns.best)),
            ("falls of the last 100", percent(s.returns.fall_rate)),
            ("evaluation without noise", evaluation),
            ("endings", endings(s)),
        ]);
    }
    lines.push(("policy", run_dir.join("policy.safetensors").display().to_string()));
    facts(&lines) + &next(run_dir)
}

fn next(run_dir: &Path) -> String {
    let dir = run_dir.display();
    format!("\nnext: herd eval --policy {dir}/policy.safetensors\n      herd report --run-dir {dir}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_summary_says_whether_it_is_complete() {
        let dir = Path::new("runs/a");
        let run = |done| Run { status: Some(Status::default()), done, target: 10 };
        assert!(text(dir, &run(10)).contains("complete\n"));
        assert!(text(dir, &run(9)).contains("the same command continues it"));
        assert!(text(dir, &run(9)).contains("herd eval --policy runs/a/policy.safetensors"));
    }
}
