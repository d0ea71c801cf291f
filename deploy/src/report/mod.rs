//! `herd report`: what a run's own records show, as figures to look at.

#[cfg(all(feature = "actor", feature = "learner"))]
pub(crate) mod chart;
#[cfg(all(feature = "actor", feature = "learner"))]
pub(crate) mod png;
pub(crate) mod records;
pub(crate) mod svg;

use crate::out;
use anyhow::Context;
use records::Records;
use std::path::PathBuf;
use svg::{Plot, Scale, Series, Style};

/// Draw the learning curve of a run from its metrics.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  herd report --run-dir runs/first           writes runs/first/report/return.svg
It works while the run goes on and needs no learner.")]
pub(crate) struct Args {
    /// The run.
    #[arg(long, value_name = "DIR")]
    run_dir: PathBuf,
    /// Print JSON: the path and the figures behind the plot.
    #[arg(long)]
    json: bool,
}

/// Episodes that the running mean is over.
const WINDOW: usize = 20;

/// `herd report`
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let records = Records::read(&args.run_dir)?;
    let path = args.run_dir.join("report").join("return.svg");
    std::fs::create_dir_all(args.run_dir.join("report")).context("make the directory of reports")?;
    std::fs::write(&path, plot(&records).to_svg()).with_context(|| format!("write {}", path.display()))?;
    if args.json {
        return out::json(&serde_json::json!({
            "path": path,
            "episodes": records.returns.len(),
            "mean_return_of_last": records.mean_of_last(WINDOW),
            "evaluations": records.evaluations,
        }));
    }
    let last = records.mean_of_last(WINDOW).map_or("–".to_owned(), |mean| format!("{mean:.1}"));
    out::print(&format!(
        "{} episodes, mean return of the last {WINDOW}: {last}\n{}",
        records.returns.len(),
        path.display()
    ))
}

fn plot(records: &Records) -> Plot {
    Plot {
        title: "Return over training".into(),
        x_label: "episode".into(),
        y_label: "return (eq 10 summed over an episode, no unit)".into(),
        x_scale: Scale::Linear,
        series: vec![
            Series { name: "episodes, with noise".into(), style: Style::Faint, points: records.returns.clone() },
            Series {
                name: format!("mean over {WINDOW} episodes"),
                style: Style::Line,
                points: records::running_mean(&records.returns, WINDOW),
            },
            Series {
                name: "evaluation, without noise".into(),
                style: Style::Dots,
                points: records.evaluations.iter().map(|e| (e.version as f64, e.mean_return)).collect(),
            },
        ],
    }
}
