//! Runs every case with every seed on a few threads; which thread runs what changes no figure but the wall time.

use super::cases::Case;
use super::figures::{Episode, Result};
use anyhow::Context;
use herd_actor::env::{Env, Observation};
use herd_actor::rollout::run_episode;
use herd_common::seed::Seed;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// The episodes of each case, in order of the seeds.
pub(crate) fn run(cases: &[Case], seeds: &[Seed], threads: usize) -> anyhow::Result<Vec<Result>> {
    let next = AtomicUsize::new(0);
    let jobs = cases.len() * seeds.len();
    let work = || {
        let mut done = Vec::new();
        let mut env: Option<(usize, Env)> = None;
        loop {
            let job = next.fetch_add(1, Ordering::Relaxed);
            if job >= jobs {
                return done;
            }
            let (case, seed) = (job / seeds.len(), job % seeds.len());
            let ready = env.take().filter(|(built, _)| *built == case);
            let (_, env) = env.insert(ready.unwrap_or_else(|| (case, Env::new(&cases[case].config))));
            done.push((job, episode(&cases[case], env, seeds[seed])));
        }
    };
    let mut done = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads.min(jobs)).map(|_| scope.spawn(work)).collect();
        threads.into_iter().map(|thread| thread.join().ok()).collect::<Option<Vec<_>>>()
    })
    .context("run the episodes: a robot panicked")?
    .concat();
    done.sort_by_key(|(job, _)| *job);
    let episodes: Vec<Episode> = done.into_iter().map(|(_, episode)| episode).collect();
    let pieces = episodes.chunks(seeds.len()).map(<[Episode]>::to_vec);
    Ok(cases.iter().zip(pieces).map(|(case, episodes)| Result::new(case, episodes)).collect())
}

fn episode(case: &Case, env: &mut Env, seed: Seed) -> Episode {
    let dim = case.config.task.kind.action_dim();
    let mut act = |observation: &Observation| {
        case.policy.as_ref().map_or_else(|| vec![0.0; dim], |policy| policy.act(observation))
    };
    #[expect(clippy::disallowed_methods, reason = "measures speed; no other figure depends on it")]
    let start = Instant::now();
    let outcome = run_episode(env, seed, &mut act, &mut |_| {});
    Episode { outcome, following: env.following(), wall_secs: start.elapsed().as_secs_f64() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::config::Config;

    #[test]
    fn threads_change_no_figure() {
        let sets = ["task.kind=constant".to_owned(), "task.episode_secs=0.3".to_owned()];
        let config = Config::load(None, &sets).expect("valid");
        let slow = config.overridden(&["task.constant.velocity_mps=0.1".into()]).expect("valid");
        let case = |config: &Config| Case { label: "case".into(), config: config.clone(), policy: None };
        let (cases, root) = ([case(&config), case(&slow)], Seed::from_number(1));
        let seeds: Vec<Seed> = (0..3).map(|i| root.child("evaluation", i)).collect();
        let outcomes = |threads| {
            let results = run(&cases, &seeds, threads).expect("runs");
            results.iter().flat_map(|r| r.episodes.iter().map(|e| e.outcome)).collect::<Vec<_>>()
        };
        let one = outcomes(1);
        assert_eq!(one.len(), 6);
        assert_eq!(one, outcomes(3));
        assert_ne!(one[0], one[3], "each case runs under its own configuration");
    }
}
