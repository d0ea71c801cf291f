//! The search for the best constant gait: a grid over the action box, finalists, then steps around the best.
//!
//! Actions are points of [−1, 1]⁴. What an action is worth is a mean over the first so many of a list of seeds that all
//! share. Pure: who asks for the values runs the episodes.

use serde::{Deserialize, Serialize};

/// A gait as an action: v_x, S, H, Δt, each in [−1, 1].
pub(super) type Action = [f32; 4];

/// What may be spent, and on what.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Plan {
    /// Simulated time in all, s.
    pub(super) budget_secs: f64,
    /// The longest that an episode can be, s.
    pub(super) episode_secs: f64,
    /// Points of the grid in each dimension; fewer if the budget is small.
    pub(super) points: u32,
    /// Episodes of a gait of the grid, each with another seed; fewer if the budget is small.
    pub(super) grid_repeats: usize,
    /// Of the grid's best, so many are looked at again.
    pub(super) finalists: usize,
    /// Episodes of a gait after the grid.
    pub(super) repeats: usize,
}

/// What came of the episodes of one gait.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tried {
    /// Mean return.
    pub(super) value: f64,
    /// Simulated time, s.
    pub(super) secs: f64,
}

/// What was found, and what it cost.
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
    /// Simulated time, s.
    pub(super) simulated_secs: f64,
    /// Distance of the neighbours looked at last, in units of the box's half width.
    pub(super) last_step: f32,
}

/// Steps no smaller than this, in units of the box's half width: 0.02 m/s of v_x at ± 1.8 m/s.
const FINEST: f32 = 0.01;

/// Tries each action with the first `repeats` seeds.
pub(super) type Judge<'a> = &'a mut dyn FnMut(&[Action], usize) -> anyhow::Result<Vec<Tried>>;

impl Plan {
    /// So many episodes fit into the budget if each is as long as it can be.
    pub(super) fn most_episodes(&self) -> u64 {
        // The sum of episodes that makes up a budget may miss it by a rounding error.
        (self.budget_secs / self.episode_secs + 1e-6) as u64
    }
}

/// The budget while it is spent.
struct Purse<'a> {
    plan: &'a Plan,
    judge: Judge<'a>,
    spent_secs: f64,
    episodes: u64,
}

impl Purse<'_> {
    /// True if so many episodes are within the budget, however long they are.
    fn affords(&self, episodes: usize) -> bool {
        self.spent_secs + episodes as f64 * self.plan.episode_secs <= self.plan.budget_secs * (1.0 + 1e-9)
    }

    fn values(&mut self, actions: &[Action], repeats: usize) -> anyhow::Result<Vec<f64>> {
        let tried = (self.judge)(actions, repeats)?;
        self.spent_secs += tried.iter().map(|tried| tried.secs).sum::<f64>();
        self.episodes += (actions.len() * repeats) as u64;
        Ok(tried.into_iter().map(|tried| tried.value).collect())
    }
}

/// Searches until the budget is spent or steps are fine enough.
pub(super) fn search(plan: &Plan, judge: Judge<'_>) -> anyhow::Result<Found> {
    let mut purse = Purse { plan, judge, spent_secs: 0.0, episodes: 0 };
    // Of what the budget allows, the finer grid comes before the surer one.
    let mut grids =
        (2..=plan.points).rev().flat_map(|k| (1..=plan.grid_repeats).rev().map(move |repeats| (k, repeats)));
    let affordable = |(k, repeats): &(u32, usize)| purse.affords(k.pow(4) as usize * repeats);
    let (points, repeats) = grids.find(affordable).unwrap_or((1, 1));
    let mut tried = grid(points);
    let values = purse.values(&tried, repeats)?;
    let mut ranked: Vec<(f64, Action)> = values.into_iter().zip(tried.iter().copied()).collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));

    let mut best = ranked[0];
    // Means over other seeds cannot be told apart: what goes on has been tried as often as what it is held against.
    let places = (1..=plan.finalists).rev().find(|places| purse.affords(places * plan.repeats)).unwrap_or(0);
    let finalists: Vec<Action> = ranked.iter().take(places).map(|(_, action)| *action).collect();
    best = best_of(&finalists, &purse.values(&finalists, plan.repeats)?).unwrap_or(best);
    let mut step = if points > 1 { 1.0 / (points - 1) as f32 } else { 0.5 };
    while !finalists.is_empty() && step >= FINEST {
        let around: Vec<Action> = neighbours(best.1, step).into_iter().filter(|near| !tried.contains(near)).collect();
        if !purse.affords(around.len() * plan.repeats) {
            break;
        }
        let better = best_of(&around, &purse.values(&around, plan.repeats)?).filter(|found| found.0 > best.0);
        tried.extend(around);
        match better {
            Some(found) => best = found,
            None => step /= 2.0,
        }
    }
    let (gaits, episodes) = (tried.len() as u64, purse.episodes);
    Ok(Found { action: best.1, value: best.0, gaits, episodes, simulated_secs: purse.spent_secs, last_step: step })
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

    /// What is found with the time of so many episodes of 10 s, each of which lasts `secs`; and how many were run.
    fn found(budget: u64, secs: f64) -> (Found, u64) {
        let mut episodes = 0;
        let budget_secs = 10.0 * budget as f64;
        let plan = Plan { budget_secs, episode_secs: 10.0, points: 3, grid_repeats: 1, finalists: 5, repeats: 2 };
        let mut judge = |actions: &[Action], repeats: usize| {
            episodes += (actions.len() * repeats) as u64;
            assert!(actions.iter().flatten().all(|x| x.abs() <= 1.0), "outside of the box: {actions:?}");
            Ok(actions.iter().map(|action| Tried { value: value(action), secs: repeats as f64 * secs }).collect())
        };
        (search(&plan, &mut judge).expect("searches"), episodes)
    }

    #[test]
    fn it_finds_the_peak_within_its_budget() {
        let (fine, counted) = found(1000, 10.0);
        assert!(value(&fine.action) > -1e-3, "{fine:?}");
        assert_eq!(fine.episodes, counted);
        assert!(fine.episodes <= 1000 && fine.gaits < fine.episodes);
    }

    #[test]
    fn more_budget_is_never_worse_and_little_is_kept_to() {
        let values: Vec<f64> = [1, 20, 81, 100, 150, 300]
            .map(|budget| {
                let (found, counted) = found(budget, 10.0);
                assert!(counted <= budget && found.episodes == counted, "{budget}: {counted}");
                found.value
            })
            .to_vec();
        assert!(values.is_sorted(), "{values:?}");
    }

    #[test]
    fn a_small_budget_makes_the_grid_less_sure_before_it_makes_it_coarser() {
        let first = |budget_secs: f64| {
            let plan = Plan { budget_secs, episode_secs: 10.0, points: 3, grid_repeats: 3, finalists: 5, repeats: 9 };
            let mut first = None;
            let mut judge = |actions: &[Action], repeats: usize| {
                first.get_or_insert((actions.len(), repeats));
                Ok(vec![Tried { value: 0.0, secs: 1e9 }; actions.len()])
            };
            search(&plan, &mut judge).expect("searches");
            first
        };
        let found = [2430.0, 2000.0, 810.0, 800.0, 160.0, 20.0].map(first);
        assert_eq!(found, [(81, 3), (81, 2), (81, 1), (16, 3), (16, 1), (1, 1)].map(Some));
    }

    #[test]
    fn time_that_falls_leave_is_spent() {
        let ((long, _), (short, _)) = (found(150, 10.0), found(150, 5.0));
        assert!(short.episodes > 150 && long.episodes <= 150, "{short:?} {long:?}");
        assert!(short.simulated_secs <= 1500.0, "{short:?}");
    }

    #[test]
    fn the_grid_has_every_corner_once() {
        assert_eq!(grid(1), [[0.0; 4]]);
        let corners = grid(3).iter().filter(|action| action.iter().all(|x| x.abs() == 1.0)).count();
        assert_eq!((grid(3).len(), corners), (81, 16));
    }
}
