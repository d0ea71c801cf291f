//! The search for the best constant gait: a grid over the action box, finalists, then steps around the best.
//!
//! Actions are points of [−1, 1]⁴. What an action is worth is a mean over the first so many of a list of seeds that all
//! share. Pure: who asks for the values runs the episodes.

use serde::{Deserialize, Serialize};

/// A gait as an action: v_x, S, H, Δt, each in [−1, 1].
pub(super) type Action = [f32; 4];

/// What may be spent, and on what.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Plan {
    /// Episodes in all.
    pub(super) budget: u64,
    /// Points of the grid in each dimension; fewer if the budget is small.
    pub(super) points: u32,
    /// Of the grid's best, so many are looked at again.
    pub(super) finalists: usize,
    /// Episodes of a gait after the grid, each with another seed.
    pub(super) repeats: usize,
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Found {
    /// The best.
    pub(super) action: Action,
    /// Its mean return in the search.
    pub(super) value: f64,
    /// Gaits tried.
    pub(super) gaits: u64,
    /// Episodes run.
    pub(super) episodes: u64,
    /// Distance of the neighbours looked at last, in units of the box's half width.
    pub(super) last_step: f32,
}

/// Steps no smaller than this, in units of the box's half width: 0.02 m/s of v_x at ± 1.8 m/s.
const FINEST: f32 = 0.01;

/// Gives the value of each action, each run with the first `repeats` seeds.
pub(super) type Judge<'a> = &'a mut dyn FnMut(&[Action], usize) -> anyhow::Result<Vec<f64>>;

/// Searches until the budget is spent or steps are fine enough.
pub(super) fn search(plan: &Plan, judge: Judge<'_>) -> anyhow::Result<Found> {
    let points = (2..=plan.points).rev().find(|k| u64::from(k.pow(4)) <= plan.budget).unwrap_or(1);
    let mut tried = grid(points);
    let (mut gaits, mut episodes) = (tried.len() as u64, tried.len() as u64);
    let values = judge(&tried, 1)?;
    let mut ranked: Vec<(f64, Action)> = values.into_iter().zip(tried.iter().copied()).collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));

    let mut best = ranked[0];
    let finalists: Vec<Action> = ranked.iter().take(plan.finalists).map(|(_, action)| *action).collect();
    let cost = (finalists.len() * plan.repeats) as u64;
    if episodes + cost <= plan.budget {
        best = best_of(&finalists, &judge(&finalists, plan.repeats)?).unwrap_or(best);
        episodes += cost;
    }
    let mut step = if points > 1 { 1.0 / (points - 1) as f32 } else { 0.5 };
    while step >= FINEST {
        let around: Vec<Action> = neighbours(best.1, step).into_iter().filter(|near| !tried.contains(near)).collect();
        let cost = (around.len() * plan.repeats) as u64;
        if episodes + cost > plan.budget {
            break;
        }
        let better = best_of(&around, &judge(&around, plan.repeats)?).filter(|found| found.0 > best.0);
        (gaits, episodes) = (gaits + around.len() as u64, episodes + cost);
        tried.extend(around);
        match better {
            Some(found) => best = found,
            None => step /= 2.0,
        }
    }
    Ok(Found { action: best.1, value: best.0, gaits, episodes, last_step: step })
}

fn best_of(actions: &[Action], values: &[f64]) -> Option<(f64, Action)> {
    values.iter().copied().zip(actions.iter().copied()).max_by(|a, b| a.0.total_cmp(&b.0))
}

/// `points` values a dimension, ends included; the middle if it is one.
fn grid(points: u32) -> Vec<Action> {
    let at = |i: u32| if points > 1 { 2.0 * i as f32 / (points - 1) as f32 - 1.0 } else { 0.0 };
    (0..points.pow(4)).map(|n| [3, 2, 1, 0].map(|power| at(n / points.pow(power) % points))).collect()
}

/// The actions one step away along each axis, within the box.
fn neighbours(of: Action, step: f32) -> Vec<Action> {
    let moved = |axis: usize, by: f32| {
        let mut action = of;
        action[axis] = (action[axis] + by).clamp(-1.0, 1.0);
        action
    };
    (0..4).flat_map(|axis| [moved(axis, -step), moved(axis, step)]).filter(|action| *action != of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PEAK: Action = [0.87, -0.31, 0.12, -0.95];

    fn value(action: &Action) -> f64 {
        -action.iter().zip(PEAK).map(|(a, p)| f64::from((a - p).powi(2))).sum::<f64>()
    }

    fn found(budget: u64) -> (Found, u64) {
        let mut episodes = 0;
        let plan = Plan { budget, points: 3, finalists: 5, repeats: 2 };
        let mut judge = |actions: &[Action], repeats: usize| {
            episodes += (actions.len() * repeats) as u64;
            assert!(actions.iter().flatten().all(|x| x.abs() <= 1.0), "outside of the box: {actions:?}");
            Ok(actions.iter().map(value).collect())
        };
        (search(&plan, &mut judge).expect("searches"), episodes)
    }

    #[test]
    fn it_finds_the_peak_within_its_budget() {
        let (fine, counted) = found(1000);
        assert!(value(&fine.action) > -1e-3, "{fine:?}");
        assert_eq!(fine.episodes, counted);
        assert!(fine.episodes <= 1000 && fine.gaits < fine.episodes);
    }

    #[test]
    fn more_budget_is_never_worse_and_little_is_kept_to() {
        let values: Vec<f64> = [1, 20, 81, 100, 150, 300]
            .map(|budget| {
                let (found, counted) = found(budget);
                assert!(counted <= budget && found.episodes == counted, "{budget}: {counted}");
                found.value
            })
            .to_vec();
        assert!(values.is_sorted(), "{values:?}");
    }

    #[test]
    fn the_grid_has_every_corner_once() {
        assert_eq!(grid(1), [[0.0; 4]]);
        let corners = grid(3).iter().filter(|action| action.iter().all(|x| x.abs() == 1.0)).count();
        assert_eq!((grid(3).len(), corners), (81, 16));
    }
}
