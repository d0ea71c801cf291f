//! Progress of a run while it happens: a bar on a terminal, a plain line now and then elsewhere. Both on stderr.

use crate::status::realtime_factor;
use crate::table::{count, duration, percent};
use herd_common::caps;
use herd_common::status::Status;
use herd_proto::address::Address;
use herd_proto::client::{Client, Error};
use herd_proto::link::StatusStream;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::path::Path;

/// Follows a learner's status and shows it.
pub(crate) struct Progress {
    learner: Address,
    stream: Option<StatusStream>,
    last: Option<Status>,
    /// The learner's uptime at the last plain line, s.
    told_at: Option<f64>,
    bar: Option<ProgressBar>,
}

/// Time between two snapshots, s: short enough that the last one is of a complete run.
const PERIOD_SECS: f64 = 0.5;
/// Least time between two plain lines, s.
const PLAIN_SECS: f64 = 5.0;
const STYLE: &str = "{bar:32} {pos}/{len} episodes  {prefix}\n{wide_msg}";

impl Progress {
    /// Shows the run in this directory.
    pub(crate) fn start(run_dir: &Path, target: u64) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::with_draw_target(Some(target), ProgressDrawTarget::stderr());
            bar.set_style(ProgressStyle::with_template(STYLE).expect("the template is valid: tested"));
            bar.set_message("starting");
            bar
        });
        Self { learner: Address::of_run(run_dir), stream: None, last: None, told_at: None, bar }
    }

    /// Waits for the next snapshot and shows it; a learner that is away is waited for. Safe to drop while it waits.
    pub(crate) async fn advance(&mut self) {
        let Some(stream) = &mut self.stream else {
            match self.connect().await {
                Ok(stream) => self.stream = Some(stream),
                Err(error) => {
                    tracing::debug!(%error, "no status yet");
                    tokio::time::sleep(caps::RECONNECT_PAUSE.0).await;
                }
            }
            return;
        };
        let Ok(Some(status)) = stream.next().await else {
            self.stream = None;
            tokio::time::sleep(caps::RECONNECT_PAUSE.0).await;
            return;
        };
        let is_over = |status: &Status| status.phase != "training";
        if !(is_over(&status) && self.last.as_ref().is_some_and(is_over)) {
            self.show(&status);
        }
        self.last = Some(status);
    }

    /// Takes the bar away and gives the last snapshot.
    pub(crate) fn finish(self) -> Option<Status> {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
        self.last
    }

    async fn connect(&self) -> Result<StatusStream, Error> {
        Client::connect(&self.learner.resolve()?).await?.watch_status(PERIOD_SECS).await
    }

    fn show(&mut self, status: &Status) {
        let Some(bar) = &self.bar else {
            // A learner that was started again counts from 0.
            let since = self.told_at.map(|at| status.uptime_secs - at).filter(|since| *since >= 0.0);
            if status.phase == "training" && since.is_some_and(|since| since < PLAIN_SECS) {
                return;
            }
            self.told_at = Some(status.uptime_secs);
            eprintln!("{}/{} episodes  {}", status.episodes, status.episodes_target, line(status));
            return;
        };
        bar.set_length(status.episodes_target);
        bar.set_position(status.episodes);
        bar.set_prefix(status.eta_secs.map(|eta| format!("{} to go", duration(eta))).unwrap_or_default());
        bar.set_message(line(status));
    }
}

/// What matters, on one line.
fn line(status: &Status) -> String {
    let (returns, rates) = (&status.returns, &status.rates);
    let eta = status.eta_secs.map(|eta| format!(" · {} to go", duration(eta))).unwrap_or_default();
    format!(
        "return {:.1} (best {:.1}) · {:.1} s long, {} fall · {} transitions/s, {} updates/s, {:.1}× real time{eta} · {}",
        returns.mean,
        returns.best,
        returns.seconds,
        percent(returns.fall_rate),
        count(rates.transitions.round() as u64),
        count(rates.updates.round() as u64),
        realtime_factor(status),
        status.bottleneck,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_template_is_valid_and_the_line_has_what_matters() {
        ProgressStyle::with_template(STYLE).expect("valid");
        let mut status = Status { eta_secs: Some(90.0), bottleneck: "actors".into(), ..Status::default() };
        status.returns.mean = 41.25;
        let line = line(&status);
        for part in ["return 41.2", "1 min 30 s to go", "· actors"] {
            assert!(line.contains(part), "{line}");
        }
    }
}
