//! How good is the controller? Speed, tracking, falls over the action box, pushes: without learning, on level ground.
//!
//! `cargo run --release -p herd-actor --example quality [-- PART… --seeds N --most N --set KEY=VALUE…]`;
//! parts are `speed`, `tracking`, `standing`, `actions` (of at most `--most` episodes a kind) and `pushes`, all of them
//! without one.

mod actions;
mod pushes;
mod walking;

use anyhow::{Context, bail};
use herd_common::config::Config;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// Episodes run side by side.
const THREADS: usize = 2;
const PARTS: [&str; 5] = ["speed", "tracking", "standing", "actions", "pushes"];

/// What was asked for on the command line.
struct Request {
    config: Config,
    parts: Vec<String>,
    seeds: u64,
    most: usize,
}

fn request() -> anyhow::Result<Request> {
    let (mut sets, mut parts, mut seeds, mut most) = (Vec::new(), Vec::new(), 10, usize::MAX);
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--set" => sets.push(words.next().context("--set needs KEY=VALUE")?),
            "--seeds" => seeds = words.next().context("--seeds needs a number")?.parse().context("read --seeds")?,
            "--most" => most = words.next().context("--most needs a number")?.parse().context("read --most")?,
            part if PARTS.contains(&part) => parts.push(word),
            _ => bail!("{word} is no part, expected one of {PARTS:?}"),
        }
    }
    if parts.is_empty() {
        parts = PARTS.map(str::to_owned).to_vec();
    }
    Ok(Request { config: Config::load(None, &sets).context("load config")?, parts, seeds, most })
}

/// `run` of every item, in their order.
fn each<T: Sync, R: Send>(items: &[T], run: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let next = AtomicUsize::new(0);
    let work = || {
        let mine = std::iter::from_fn(|| {
            let index = next.fetch_add(1, Ordering::Relaxed);
            items.get(index).map(|item| (index, run(item)))
        });
        mine.collect::<Vec<_>>()
    };
    let mut all: Vec<(usize, R)> = thread::scope(|scope| {
        let threads = [(); THREADS].map(|()| scope.spawn(work));
        threads.into_iter().flat_map(|thread| thread.join().expect("no episode panics")).collect()
    });
    all.sort_by_key(|(index, _)| *index);
    all.into_iter().map(|(_, result)| result).collect()
}

#[expect(clippy::print_stdout, reason = "the tables are for people")]
fn main() -> anyhow::Result<()> {
    let Request { config, parts, seeds, most } = request()?;
    for part in parts {
        let table = match part.as_str() {
            "speed" => walking::speed(&config, seeds)?,
            "tracking" => walking::tracking(&config, seeds)?,
            "standing" => walking::standing(&config, seeds)?,
            "actions" => actions::table(&config, seeds, most)?,
            _ => pushes::table(&config)?,
        };
        println!("{table}");
    }
    Ok(())
}
