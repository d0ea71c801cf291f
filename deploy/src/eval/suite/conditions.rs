//! What the suite tries: one quantity at a time, the rest as plain as can be, and pushes from all sides.

use crate::eval::bench::Push;
use crate::eval::cases::{at_speed, gait_sets};
use herd_common::config::Config;
use herd_common::config::task::Constant;
use std::f64::consts::TAU;

/// One quantity that is varied.
#[derive(Clone, Debug)]
pub(super) struct Group {
    /// Its name, also of its picture.
    pub(super) name: &'static str,
    /// What its values are.
    pub(super) quantity: &'static str,
    /// Their unit; empty if they have none.
    pub(super) unit: &'static str,
    /// Where the plain case stands among them, if it does.
    pub(super) plain: Option<f64>,
    /// What is tried.
    pub(super) settings: Vec<Setting>,
}

/// One value of the quantity.
#[derive(Clone, Debug)]
pub(super) struct Setting {
    /// In the group's unit.
    pub(super) value: f64,
    /// Overrides of the configuration.
    pub(super) sets: Vec<String>,
}

/// Speeds of the sweep, m/s; the top of the action box comes on top.
const SPEEDS: [f64; 6] = [0.2, 0.4, 0.6, 0.8, 1.0, 1.2];

/// Directions of the push map.
pub(super) const DIRECTIONS: usize = 8;
/// Impulses of the push map, N·s: 0.25 to 1 m/s for 13.6 kg.
pub(super) const IMPULSES_NS: [f64; 4] = [3.4, 6.8, 10.2, 13.6];
/// Phases of the gait at which each push comes.
const PHASES: u32 = 10;
const PHASES_QUICK: u32 = 2;
/// When the first of them comes: the robot has long been at its speed.
const PUSH_AT_SECS: f64 = 2.0;
/// Length of a pushed episode, s: time enough to fall or to be back on one's feet.
pub(super) const PUSHED_SECS: f64 = 5.0;

/// Everything but the pushes, for a policy.
pub(super) fn groups(config: &Config) -> Vec<Group> {
    let friction = config.sim.ground_friction;
    let group = |name, quantity, unit, key: &str, si_per_unit: f64, values: &[f64]| Group {
        name,
        quantity,
        unit,
        plain: Some(if name == "friction" { friction } else { 0.0 }),
        settings: values.iter().map(|value| setting(key, *value, value * si_per_unit)).collect(),
    };
    vec![
        group("friction", "friction μ", "", "friction_factor", 1.0 / friction, &[0.3, 0.5, 0.8]),
        group("payload", "payload", "kg", "payload_kg", 1.0, &[1.0, 2.0, 3.0, 4.0]),
        group("slope", "slope uphill", "°", "slope_deg", 1.0, &[5.0, 10.0, 15.0]),
        group("bumps", "bumps", "mm", "bump_m", 1e-3, &[5.0, 10.0, 15.0, 20.0]),
        group("steps", "steps", "mm", "step_m", 1e-3, &[10.0, 20.0, 30.0]),
        group("noise", "sensor noise", "σ", "noise", 1.0, &[1.0, 2.0]),
        Group {
            name: "delay",
            quantity: "delay of torques",
            unit: "ticks",
            plain: Some(0.0),
            settings: vec![Setting { value: 1.0, sets: vec!["scenario.delay_ticks=[1, 1]".into()] }],
        },
    ]
}

/// The speeds of a constant gait: its strides fit them. At the top of the box its steps are the shortest that there are.
pub(super) fn speeds(config: &Config) -> Group {
    let gait = config.task.constant;
    let top = Constant { step_secs: config.task.gait.step_secs[0], ..gait };
    let top = at_speed(top, config.task.gait.velocity_mps[1]);
    let gaits = SPEEDS.into_iter().map(|speed| at_speed(gait, speed)).chain([top]);
    Group {
        name: "speed",
        quantity: "speed asked for",
        unit: "m/s",
        plain: None,
        settings: gaits.map(|gait| Setting { value: gait.velocity_mps, sets: gait_sets(&gait).into() }).collect(),
    }
}

/// The pushes of one impulse (N·s) from one direction, at every phase of a trot with this gait's steps.
pub(super) fn pushes(direction: usize, impulse_ns: f64, gait: &Constant, quick: bool) -> Vec<Push> {
    let (phases, angle) = (if quick { PHASES_QUICK } else { PHASES }, direction_rad(direction));
    let at = |n: u32| PUSH_AT_SECS + 2.0 * gait.step_secs * f64::from(n) / f64::from(phases);
    let impulse_ns = [impulse_ns * angle.cos(), impulse_ns * angle.sin()];
    (0..phases).map(|n| Push { at_secs: at(n), impulse_ns }).collect()
}

/// Whereto a push goes, rad: from +x, forwards, towards +y, left.
pub(super) fn direction_rad(direction: usize) -> f64 {
    TAU * direction as f64 / DIRECTIONS as f64
}

fn setting(key: &str, value: f64, in_si: f64) -> Setting {
    Setting { value, sets: vec![format!("scenario.{key}=[{in_si:?}, {in_si:?}]")] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_setting_is_a_valid_configuration_of_its_own() {
        let config = Config::load(None, &["task.kind=constant".into()]).expect("valid");
        let all: Vec<Group> = groups(&config).into_iter().chain([speeds(&config)]).collect();
        let changed = all.iter().flat_map(|group| {
            group.settings.iter().map(|setting| config.overridden(&setting.sets).expect(group.name).to_toml())
        });
        let texts: std::collections::BTreeSet<String> = changed.collect();
        assert_eq!(texts.len(), all.iter().map(|group| group.settings.len()).sum::<usize>());
    }

    #[test]
    fn friction_is_what_it_says() {
        let config = Config::default();
        let group = &groups(&config)[0];
        for setting in &group.settings {
            let changed = config.overridden(&setting.sets).expect("valid");
            let friction = changed.sim.ground_friction * changed.scenario.friction_factor[0];
            assert!((friction - setting.value).abs() < 1e-12, "{friction}");
        }
    }

    #[test]
    fn pushes_spread_over_one_period_and_all_sides() {
        let gait = Config::default().task.constant;
        let pushes = pushes(2, 6.8, &gait, false);
        assert_eq!(pushes.len(), 10);
        assert!((pushes[9].at_secs - 2.27).abs() < 1e-9, "{}", pushes[9].at_secs);
        let [x, y] = pushes[4].impulse_ns;
        assert!(x.abs() < 1e-9 && (y - 6.8).abs() < 1e-9, "to the left: {x} {y}");
    }
}
