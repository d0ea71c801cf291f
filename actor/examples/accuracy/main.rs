//! How fine must the physics step be? Compares solver steps per tick, and halved ticks, with much finer ones.
//!
//! `cargo run --release -p herd-actor --example accuracy [-- SEEDS]` prints the tables of `docs/accuracy.md`.
//! `flight` replays torques without feedback, `gait` walks with it.

mod flight;
mod gait;

use anyhow::Context;
use herd_common::config::Config;

/// A physics step to judge: length of a tick, s, and solver steps in it.
#[derive(Clone, Copy, PartialEq)]
struct Steps {
    tick_secs: f64,
    substeps: usize,
}

impl Steps {
    /// Cheapest first, as far as that can be said.
    const JUDGED: [Self; 5] =
        [Self::new(0.002, 1), Self::new(0.002, 2), Self::new(0.002, 4), Self::new(0.002, 8), Self::new(0.001, 1)];

    const fn new(tick_secs: f64, substeps: usize) -> Self {
        Self { tick_secs, substeps }
    }

    /// The configuration with these steps and `sets`.
    fn config(self, sets: &[String]) -> anyhow::Result<Config> {
        let own = [format!("sim.tick_secs={}", self.tick_secs), format!("sim.substeps={}", self.substeps)];
        Config::load(None, &[&own, sets].concat()).context("load config")
    }

    fn name(self) -> String {
        format!("{} ms × {}", self.tick_secs * 1e3, self.substeps)
    }
}

#[expect(clippy::print_stdout, reason = "the tables are for people and for the documentation")]
fn main() -> anyhow::Result<()> {
    let seeds = std::env::args().nth(1).map_or(Ok(4), |seeds| seeds.parse()).context("read SEEDS")?;
    println!("{}\n{}", flight::table()?, gait::tables(seeds)?);
    Ok(())
}
