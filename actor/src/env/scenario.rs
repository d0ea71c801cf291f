//! What one episode meets: the ranges of the configuration, drawn by the episode's seed.
//!
//! Every quantity has a branch of the seed tree to itself, so widening one range leaves what the others draw as it was.

use crate::sim::{Ground, Site};
use herd_common::config::Config;
use herd_common::seed::Seed;
use nalgebra::Vector3;
use rand::RngExt;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Length of a push, s.
pub const PUSH_SECS: f64 = 0.05;

/// A force on the trunk for some ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Push {
    /// World, N.
    pub(super) force: Vector3<f64>,
    pub(super) ticks: u32,
}

/// The draw of one episode.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Scenario {
    /// Ground, friction and payload.
    pub(super) site: Site,
    /// Pushes by the tick before which they begin.
    pub(super) pushes: BTreeMap<u64, Push>,
    /// Factor on the standard deviations of the sensors.
    pub(super) noise: f64,
    /// Ticks by which torques are late.
    pub(super) delay_ticks: usize,
}

impl Scenario {
    /// What the episode of `seed` meets.
    pub(super) fn draw(config: &Config, seed: Seed) -> Self {
        let (ranges, seed) = (&config.scenario, seed.child("scenario", 0));
        let draw = |name: &str, range: [f64; 2]| within(range, seed.child(name, 0).rng().random());
        let (bump, step) = (draw("bump", ranges.bump_m), draw("step", ranges.step_m));
        let slope = draw("slope", ranges.slope_deg).to_radians();
        let [least, most] = ranges.delay_ticks;
        let push = draw("push", ranges.push_ns);
        Self {
            site: Site {
                ground: Ground::new(slope, bump, step, seed.child("ground", 0)),
                friction_factor: draw("friction", ranges.friction_factor),
                payload_kg: draw("payload", ranges.payload_kg),
            },
            pushes: pushes(config, push, draw("push_every", ranges.push_every_secs), seed.child("pushes", 0)),
            noise: draw("noise", ranges.noise),
            delay_ticks: seed.child("delay", 0).rng().random_range(least..=most) as usize,
        }
    }
}

/// Pushes of this impulse (N·s) all through the episode; the first comes within the first interval.
fn pushes(config: &Config, impulse: f64, every_secs: f64, seed: Seed) -> BTreeMap<u64, Push> {
    if impulse == 0.0 {
        return BTreeMap::new();
    }
    let mut rng = seed.rng();
    let tick = config.sim.tick_secs;
    let ticks = ((PUSH_SECS / tick).round() as u32).max(1);
    let first = rng.random::<f64>();
    let count = (config.task.episode_secs / every_secs - first).ceil().max(0.0) as u32;
    (0..count)
        .map(|n| {
            let side = rng.random_range(0.0..TAU);
            let force = Vector3::new(side.cos(), side.sin(), 0.0) * (impulse / (f64::from(ticks) * tick));
            ((every_secs * (first + f64::from(n)) / tick) as u64, Push { force, ticks })
        })
        .collect()
}

fn within([lowest, highest]: [f64; 2], share: f64) -> f64 {
    lowest + (highest - lowest) * share
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draw(sets: &[&str], seed: u64) -> Scenario {
        let sets: Vec<String> = sets.iter().map(|set| format!("scenario.{set}")).collect();
        Scenario::draw(&Config::load(None, &sets).expect("valid"), Seed::from_number(seed))
    }

    #[test]
    fn the_default_draws_nothing() {
        let plain = draw(&[], 1);
        assert_eq!((&plain.site, plain.pushes.len(), plain.noise, plain.delay_ticks), (&Site::default(), 0, 0.0, 0));
        assert_eq!(plain, draw(&[], 2));
    }

    #[test]
    fn draws_stay_in_their_range_and_differ() {
        let sets = ["payload_kg=[1, 3]", "friction_factor=[0.5, 1.5]", "delay_ticks=[0, 1]"];
        let drawn: Vec<Scenario> = (0..200).map(|seed| draw(&sets, seed)).collect();
        assert!(drawn.iter().all(|one| (1.0..=3.0).contains(&one.site.payload_kg)));
        let mean = drawn.iter().map(|one| one.site.payload_kg).sum::<f64>() / 200.0;
        assert!((mean - 2.0).abs() < 0.12, "{mean} kg: uniform, σ of the mean 0.04 kg");
        let late = drawn.iter().filter(|one| one.delay_ticks == 1).count();
        assert!((70..=130).contains(&late), "{late} of 200");
        // The friction is drawn apart from the payload.
        let above = |one: &&Scenario| (one.site.friction_factor > 1.0) == (one.site.payload_kg > 2.0);
        let together = drawn.iter().filter(above).count();
        assert!((70..=130).contains(&together), "{together} of 200");
    }

    #[test]
    fn one_range_leaves_the_draws_of_the_others_alone() {
        let (one, both) = (draw(&["payload_kg=[0, 4]"], 9), draw(&["payload_kg=[0, 4]", "slope_deg=[0, 15]"], 9));
        assert_eq!(one.site.payload_kg, both.site.payload_kg);
        assert!(both.site.ground.slope_rad() > 0.0);
    }

    #[test]
    fn pushes_come_at_their_interval_with_their_impulse_from_all_sides() {
        let pushes = draw(&["push_ns=[5, 5]", "push_every_secs=[0.5, 0.5]"], 4).pushes;
        assert!((19..=20).contains(&pushes.len()), "{}", pushes.len());
        let begins: Vec<u64> = pushes.keys().copied().collect();
        assert!(begins[0] < 250 && begins.windows(2).all(|pair| (249..=251).contains(&(pair[1] - pair[0]))));
        for push in pushes.values() {
            assert!((push.force.norm() * f64::from(push.ticks) * 0.002 - 5.0).abs() < 1e-9 && push.force.z == 0.0);
        }
        let mean: Vector3<f64> = pushes.values().map(|push| push.force / 100.0).sum::<Vector3<f64>>() / 20.0;
        assert!(mean.norm() < 0.6, "{mean}");
    }
}
