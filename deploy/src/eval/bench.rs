//! Runs every case with every seed on a few threads; which thread runs what changes no figure but the wall time.

use super::cases::Case;
use super::figures::{Episode, Result};
use anyhow::Context;
use herd_actor::env::{Env, Observation, PUSH_SECS};
use herd_actor::rollout;
use herd_common::seed::Seed;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// One episode to run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Job {
    /// Index of its case.
    pub(crate) case: usize,
    /// Its seed.
    pub(crate) seed: Seed,
    /// A push on top of what the case's scenario draws.
    pub(crate) push: Option<Push>,
}

/// One push at a given time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Push {
    /// Since the episode began, s.
    pub(crate) at_secs: f64,
    /// Along world x and y, N·s.
    pub(crate) impulse_ns: [f64; 2],
}

/// The episodes of each case, in order of the seeds.
pub(crate) fn run(cases: &[Case], seeds: &[Seed], threads: usize) -> anyhow::Result<Vec<Result>> {
    let jobs = |case| seeds.iter().map(move |seed| Job { case, seed: *seed, push: None });
    let jobs: Vec<Job> = (0..cases.len()).flat_map(jobs).collect();
    let episodes = episodes(cases, &jobs, threads, &|| ())?;
    let pieces = episodes.chunks(seeds.len()).map(<[Episode]>::to_vec);
    Ok(cases.iter().zip(pieces).map(|(case, episodes)| Result::new(case, episodes)).collect())
}

/// The episodes of these jobs, in their order; `done` is told of each that is over.
pub(crate) fn episodes(
    cases: &[Case],
    jobs: &[Job],
    threads: usize,
    done: &(dyn Fn() + Sync),
) -> anyhow::Result<Vec<Episode>> {
    let next = AtomicUsize::new(0);
    let work = || {
        let mut finished = Vec::new();
        let mut env: Option<(usize, Env)> = None;
        while let Some((index, job)) = {
            let index = next.fetch_add(1, Ordering::Relaxed);
            jobs.get(index).map(|job| (index, job))
        } {
            let case = &cases[job.case];
            let ready = env.take().filter(|(built, _)| *built == job.case);
            let (_, env) = env.insert(ready.unwrap_or_else(|| (job.case, Env::new(&case.config))));
            finished.push((index, episode(case, env, job)));
            done();
        }
        finished
    };
    let mut finished = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads.min(jobs.len())).map(|_| scope.spawn(work)).collect();
        threads.into_iter().map(|thread| thread.join().ok()).collect::<Option<Vec<_>>>()
    })
    .context("run the episodes: a robot panicked")?
    .concat();
    finished.sort_by_key(|(index, _)| *index);
    Ok(finished.into_iter().map(|(_, episode)| episode).collect())
}

fn episode(case: &Case, env: &mut Env, job: &Job) -> Episode {
    let dim = case.config.task.kind.action_dim();
    let mut act = |observation: &Observation| {
        case.policy.as_ref().map_or_else(|| vec![0.0; dim], |policy| policy.act(observation))
    };
    #[expect(clippy::disallowed_methods, reason = "measures speed; no other figure depends on it")]
    let start = Instant::now();
    let observation = env.reset(job.seed);
    if let Some(Push { at_secs, impulse_ns: [x, y] }) = job.push {
        env.push_after(at_secs, &([x, y, 0.0].map(|impulse| impulse / PUSH_SECS).into()), PUSH_SECS);
    }
    let outcome = rollout::finish(env, observation, &mut act, &mut |_| ControlFlow::Continue(()));
    let outcome = outcome.expect("this sink never breaks the episode off");
    let wall_secs = start.elapsed().as_secs_f64();
    let cost_of_transport = env.figures(0.0).cost_of_transport;
    Episode { outcome, cost_of_transport, following: env.following(), wall_secs }
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
