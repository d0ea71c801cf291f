//! How far the whole is: which step of how many, and about how long it still takes.

use crate::table::{count, duration};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// The steps of a reproduction with the time that each is expected to take on two cores, s; 0 for one that is done.
#[derive(Debug)]
pub(super) struct Course {
    expected: Vec<f64>,
}

impl Course {
    /// A course of these steps.
    pub(super) fn new(expected: Vec<f64>) -> Self {
        Self { expected }
    }

    /// Time still needed before step `index` begins, after `elapsed` s: what is left as expected, but as fast as what is
    /// over went.
    pub(super) fn remaining_secs(&self, index: usize, elapsed: f64) -> f64 {
        let (over, left) = self.expected.split_at(index.min(self.expected.len()));
        let (over, left) = (over.iter().sum::<f64>(), left.iter().sum::<f64>());
        if over > 0.0 { left * elapsed / over } else { left }
    }

    /// The line that announces step `index`.
    pub(super) fn headline(&self, index: usize, name: &str, elapsed: f64) -> String {
        let (n, left) = (self.expected.len(), duration(self.remaining_secs(index, elapsed)));
        let state = if self.expected[index] > 0.0 { format!("about {left} to go") } else { "done before".to_owned() };
        format!("[{}/{n}] {name} · {state}", index + 1)
    }
}

/// Counts the episodes of one step while several threads run them: a bar on a terminal, else a line now and then.
pub(super) struct Meter {
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
    /// A meter of so many episodes.
    pub(super) fn new(name: &str, total: u64) -> Self {
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
    pub(super) fn tick(&self) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        if let Some(bar) = &self.bar {
            return bar.set_position(done);
        }
        let Ok(mut told) = self.told.lock() else { return };
        if told.elapsed() >= PLAIN {
            *told += PLAIN;
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
    fn what_is_left_goes_as_fast_as_what_is_over() {
        let course = Course::new(vec![0.0, 100.0, 100.0, 50.0]);
        assert_eq!(course.remaining_secs(0, 0.0), 250.0);
        assert_eq!(course.remaining_secs(1, 0.1), 250.0, "nothing was done yet that tells");
        assert_eq!(course.remaining_secs(2, 50.0), 75.0, "twice as fast as expected");
        assert_eq!(course.remaining_secs(4, 60.0), 0.0);
        assert_eq!(course.headline(0, "gait, seed 1", 0.0), "[1/4] gait, seed 1 · done before");
        assert_eq!(course.headline(2, "gait, seed 3", 50.0), "[3/4] gait, seed 3 · about 1 min 15 s to go");
    }

    #[test]
    fn the_template_is_valid() {
        ProgressStyle::with_template(STYLE).expect("valid");
    }
}
