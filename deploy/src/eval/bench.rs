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

/// How jobs are run.
pub(crate) struct Options<'a> {
    /// At once.
    pub(crate) threads: usize,
    /// True when it is to end early, without a result.
    pub(crate) stop: &'a (dyn Fn() -> bool + Sync),
    /// Is told of each that is over.
    pub(crate) done: &'a (dyn Fn() + Sync),
}

/// The episodes of each case, in order of the seeds.
pub(crate) fn run(cases: &[Case], seeds: &[Seed], threads: usize) -> anyhow::Result<Vec<Result>> {
    let jobs = jobs(cases, seeds);
    let episodes = episodes(cases, &jobs, threads, &|| ())?;
    let pieces = episodes.chunks(seeds.len()).map(<[Episode]>::to_vec);
    Ok(cases.iter().zip(pieces).map(|(case, episodes)| Result::new(case, episodes)).collect())
}

/// Every case with every seed, case by case.
pub(crate) fn jobs(cases: &[Case], seeds: &[Seed]) -> Vec<Job> {
    let of = |case| seeds.iter().map(move |seed| Job { case, seed: *seed, push: None });
    (0..cases.len()).flat_map(of).collect()
}

/// The episodes of these jobs, in their order; `done` is told of each that is over.
pub(crate) fn episodes(
    cases: &[Case],
    jobs: &[Job],
    threads: usize,
    done: &(dyn Fn() + Sync),
) -> anyhow::Result<Vec<Episode>> {
    each(cases, jobs, &Options { threads, stop: &|| false, done }, &episode)
}

/// What `run` makes of each of these jobs, in their order; a thread keeps its robot while it runs the same case.
pub(crate) fn each<T: Send>(
    cases: &[Case],
    jobs: &[Job],
    options: &Options<'_>,
    run: &(dyn Fn(&mut Env, &Case, &Job) -> T + Sync),
) -> anyhow::Result<Vec<T>> {
    let next = AtomicUsize::new(0);
    let work = || {
        let mut finished = Vec::new();
        let mut env: Option<(usize, Env)> = None;
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = jobs.get(index).filter(|_| !(options.stop)()) else { return finished };
            let case = &cases[job.case];
            let ready = env.take().filter(|(built, _)| *built == job.case);
            let (_, env) = env.insert(ready.unwrap_or_else(|| (job.case, Env::new(&case.config))));
            finished.push((index, run(env, case, job)));
            (options.done)();
        }
    };
    let mut finished: Vec<(usize, T)> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..options.threads.min(jobs.len())).map(|_| scope.spawn(work)).collect();
        threads.into_iter().map(|thread| thread.join().ok()).collect::<Option<Vec<_>>>()
    })
    .context("run the episodes: a robot panicked")?
    .into_iter()
    .flatten()
    .collect();
    anyhow::ensure!(finished.len() == jobs.len(), "stopped after {} of {} episodes", finished.len(), jobs.len());
    finished.sort_by_key(|(index, _)| *index);
    Ok(finished.into_iter().map(|(_, made)| made).collect())
}

impl Job {
    /// Begins its episode; what the policy sees first.
    pub(crate) fn begin(&self, env: &mut Env) -> Observation {
        let observation = env.reset(self.seed);
        if let Some(Push { at_secs, impulse_ns: [x, y] }) = self.push {
            env.push_after(at_secs, &([x, y, 0.0].map(|impulse| impulse / PUSH_SECS).into()), PUSH_SECS);
        }
        observation
    }
}

fn episode(env: &mut Env, case: &Case, job: &Job) -> Episode {
    #[expect(clippy::disallowed_methods, reason = "measures speed; no other figure depends on it")]
    let start = Instant::now();
    let observation = job.begin(env);
    let outcome = rollout::finish(env, observation, &mut |seen| case.act(seen), &mut |_| ControlFlow::Continue(()));
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
        let stopped = Options { threads: 2, stop: &|| true, done: &|| () };
        let error = each(&cases, &jobs(&cases, &seeds), &stopped, &episode).expect_err("stopped").to_string();
        assert!(error.contains("stopped after 0 of 6"), "{error}");
    }
}
