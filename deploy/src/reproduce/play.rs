//! Runs every player with every seed on a few threads, without noise; which thread runs what changes nothing.

use super::course::Meter;
use anyhow::Context;
use herd_actor::env::{Env, Observation};
use herd_actor::film::{Film, film};
use herd_common::config::Config;
use herd_common::policy::Policy;
use herd_common::seed::Seed;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio_util::sync::CancellationToken;

/// Who acts, and where.
#[derive(Clone, Debug)]
pub(super) struct Player {
    /// The configuration it runs under.
    pub(super) config: Config,
    /// The policy; none for a constant gait.
    pub(super) policy: Option<Policy>,
}

/// How episodes are run.
pub(super) struct Options<'a> {
    /// Threads.
    pub(super) threads: usize,
    /// Of each player, so many first episodes are filmed.
    pub(super) filmed: usize,
    /// Cancelled when it is to end early.
    pub(super) stop: &'a CancellationToken,
    /// Hears of every episode.
    pub(super) meter: &'a Meter,
}

/// Time between two pictures, s.
pub(super) const FRAME_SECS: f64 = 0.02;

/// The episodes of each player, in order of the seeds.
pub(super) fn play(players: &[Player], seeds: &[Seed], options: &Options<'_>) -> anyhow::Result<Vec<Vec<Film>>> {
    let next = AtomicUsize::new(0);
    let jobs = players.len() * seeds.len();
    let work = || {
        let mut done = Vec::new();
        let mut env: Option<(usize, Env)> = None;
        loop {
            let job = next.fetch_add(1, Ordering::Relaxed);
            if job >= jobs || options.stop.is_cancelled() {
                return done;
            }
            let (player, seed) = (job / seeds.len(), job % seeds.len());
            let ready = env.take().filter(|(built, _)| *built == player);
            let (_, env) = env.insert(ready.unwrap_or_else(|| (player, Env::new(&players[player].config))));
            done.push((job, episode(&players[player], env, seeds[seed], seed < options.filmed)));
            options.meter.tick();
        }
    };
    let mut done: Vec<(usize, Film)> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..options.threads.min(jobs)).map(|_| scope.spawn(work)).collect();
        threads.into_iter().map(|thread| thread.join().ok()).collect::<Option<Vec<_>>>()
    })
    .context("run the episodes: a robot panicked")?
    .into_iter()
    .flatten()
    .collect();
    anyhow::ensure!(done.len() == jobs, "stopped after {} of {jobs} episodes", done.len());
    done.sort_by_key(|(job, _)| *job);
    let mut films = done.into_iter().map(|(_, film)| film);
    Ok(players.iter().map(|_| films.by_ref().take(seeds.len()).collect()).collect())
}

fn episode(player: &Player, env: &mut Env, seed: Seed, filmed: bool) -> Film {
    let dim = player.config.task.kind.action_dim();
    let mut act = |observation: &Observation| {
        player.policy.as_ref().map_or_else(|| vec![0.0; dim], |policy| policy.act(observation))
    };
    let every = (FRAME_SECS / player.config.sim.tick_secs).round() as u64;
    film(env, seed, if filmed { every } else { 0 }, &mut act)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn players() -> Vec<Player> {
        let sets = ["task.kind=constant".to_owned(), "task.episode_secs=0.3".to_owned()];
        let config = Config::load(None, &sets).expect("valid");
        let slow = config.overridden(&["task.constant.velocity_mps=0.1".into()]).expect("valid");
        [config, slow].map(|config| Player { config, policy: None }).into()
    }

    fn played(threads: usize, stop: &CancellationToken) -> anyhow::Result<Vec<Vec<Film>>> {
        let root = Seed::from_number(1);
        let seeds: Vec<Seed> = (0..3).map(|i| root.child("evaluation", i)).collect();
        let meter = Meter::new("episodes", 6);
        play(&players(), &seeds, &Options { threads, filmed: 1, stop, meter: &meter })
    }

    #[test]
    fn threads_change_nothing_and_the_first_of_each_is_filmed() {
        let stop = CancellationToken::new();
        let one = played(1, &stop).expect("runs");
        assert_eq!(one, played(3, &stop).expect("runs"));
        assert_eq!((one.len(), one[0].len(), one[1].len()), (2, 3, 3));
        for films in &one {
            let pictures: Vec<usize> = films.iter().map(|film| film.frames.len()).collect();
            assert_eq!(pictures, [16, 0, 0]);
        }
        assert_ne!(one[0][0].outcome, one[1][0].outcome, "each player runs under its own configuration");
    }

    #[test]
    fn what_was_stopped_is_no_result() {
        let stop = CancellationToken::new();
        stop.cancel();
        assert!(played(2, &stop).expect_err("stopped").to_string().contains("stopped after 0 of 6"));
    }
}
