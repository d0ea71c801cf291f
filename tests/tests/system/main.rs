//! What herd promises, tried with real processes: one module a subject, one test a behaviour.

mod by_hand;
mod determinism;
mod disk;
mod hosts;
mod python;
mod reproduce;
mod scale;
mod services;
mod sim2sim;
mod stopping;
mod train;
mod watching;
mod wire;

/// Says that a test was not run; past the test harness, which keeps back what passing tests print.
fn skipped(test: &str, why: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "skipped {test}: {why}");
}
