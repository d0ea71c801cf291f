//! Counts episodes while several threads run them: a bar on a terminal, else a line now and then; both on stderr.

use crate::table::{count, duration};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// What is done of so many.
pub(crate) struct Meter {
    name: String,
    total: u64,
    done: AtomicU64,
    bar: Option<ProgressBar>,
    start: Instant,
    told: Mutex<Instant>,
}

/// Least time between two plain lines.
const PLAIN: Duration = Duration::from_secs(5);
const STYLE: &str = "{bar:32} {pos}/{len} {msg}  {eta} to go";

impl Meter {
    /// A meter of so many things of this name.
    pub(crate) fn new(name: &str, total: u64) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr());
            bar.set_style(ProgressStyle::with_template(STYLE).expect("the template is valid: tested"));
            bar.set_message(name.to_owned());
            bar
        });
        #[expect(clippy::disallowed_methods, reason = "progress for people")]
        let now = Instant::now();
        Self { name: name.to_owned(), total, done: AtomicU64::new(0), bar, start: now, told: Mutex::new(now) }
    }

    /// One more is done.
    pub(crate) fn tick(&self) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        if let Some(bar) = &self.bar {
            return bar.set_position(done);
        }
        let Ok(mut told) = self.told.lock() else { return };
        let since = told.elapsed();
        if since >= PLAIN {
            *told += since;
            let left = self.start.elapsed().as_secs_f64() * self.total.saturating_sub(done) as f64 / done as f64;
            eprintln!("{}/{} {}  {} to go", count(done), count(self.total), self.name, duration(left));
        }
    }
}

impl Drop for Meter {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_template_is_valid() {
        ProgressStyle::with_template(STYLE).expect("valid");
    }
}
