//! Films of episodes without noise: of every case with every seed, the first ones with pictures.

use crate::eval::bench::{self, Job};
use crate::eval::cases::Case;
use crate::meter::Meter;
use herd_actor::env::Env;
use herd_actor::film::{self, Film};
use herd_common::seed::Seed;
use tokio_util::sync::CancellationToken;

/// How episodes are run.
pub(super) struct Options<'a> {
    /// Threads.
    pub(super) threads: usize,
    /// Of each case, the first episode is filmed.
    pub(super) filmed: bool,
    /// Cancelled when it is to end early.
    pub(super) stop: &'a CancellationToken,
    /// Hears of every episode.
    pub(super) meter: &'a Meter,
}

/// Time between two pictures, s.
pub(super) const FRAME_SECS: f64 = 0.02;

/// The episodes of each case, in order of the seeds.
pub(super) fn play(cases: &[Case], seeds: &[Seed], options: &Options<'_>) -> anyhow::Result<Vec<Vec<Film>>> {
    let filmed = |job: &Job| options.filmed && seeds.first() == Some(&job.seed);
    let run = |env: &mut Env, case: &Case, job: &Job| shoot(env, case, job, filmed(job));
    let (stop, done) = (|| options.stop.is_cancelled(), || options.meter.tick());
    let pool = bench::Options { threads: options.threads, stop: &stop, done: &done };
    let films = bench::each(cases, &bench::jobs(cases, seeds), &pool, &run)?;
    let mut films = films.into_iter();
    Ok(cases.iter().map(|_| films.by_ref().take(seeds.len()).collect()).collect())
}

/// One episode, with pictures or without.
pub(super) fn shoot(env: &mut Env, case: &Case, job: &Job, filmed: bool) -> Film {
    let every = if filmed { (FRAME_SECS / case.config.sim.tick_secs).round() as u64 } else { 0 };
    let observation = job.begin(env);
    film::finish(env, observation, every, &mut |seen| case.act(seen))
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::config::Config;

    #[test]
    fn the_first_episode_of_each_case_is_filmed() {
        let sets = ["task.kind=constant".to_owned(), "task.episode_secs=0.3".to_owned()];
        let config = Config::load(None, &sets).expect("valid");
        let case = Case { label: "gait".into(), config, policy: None };
        let root = Seed::from_number(1);
        let seeds: Vec<Seed> = (0..3).map(|i| root.child("evaluation", i)).collect();
        let (stop, meter) = (CancellationToken::new(), Meter::new("episodes", 6));
        let played = |threads| {
            let options = Options { threads, filmed: true, stop: &stop, meter: &meter };
            play(&[case.clone(), case.clone()], &seeds, &options).expect("runs")
        };
        let films = played(1);
        assert_eq!(films, played(3));
        for films in &films {
            let pictures: Vec<usize> = films.iter().map(|film| film.frames.len()).collect();
            assert_eq!(pictures, [16, 0, 0]);
        }
        assert_ne!(films[0][0].outcome, films[0][1].outcome, "each has its own seed");
    }
}
