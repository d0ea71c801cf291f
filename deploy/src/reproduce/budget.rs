//! How many episodes a run needs for as many transitions as another had, found in rounds.
//!
//! A run counts episodes, and how long they get shows only as it learns. So it is made longer round by round: each goal
//! is a function of the episodes committed so far, hence the same for equal runs, however often they were interrupted,
//! unless a round that grew far beyond the budget had to be broken off.

/// Least episodes of the first round; else so many that they hold the budget if each lasts as long as it can.
const FIRST: u64 = 16;
/// Most decisions of an episode: 10 s of 25 ms.
const LONGEST: u64 = 400;
/// Episodes whose length is taken for that of those to come.
const RECENT: usize = 50;

/// Episodes that the run is to have next, if those with these numbers of decisions are fewer than `wanted` transitions.
pub(super) fn next_target(decisions: &[u64], wanted: u64) -> Option<u64> {
    let (done, total) = (decisions.len() as u64, decisions.iter().sum::<u64>());
    if total >= wanted {
        return None;
    }
    let recent = &decisions[decisions.len().saturating_sub(RECENT)..];
    let mean = recent.iter().sum::<u64>() as f64 / recent.len().max(1) as f64;
    let missing = ((wanted - total) as f64 / mean.max(1.0)).ceil() as u64;
    // At most as many again: lengths change while it learns.
    Some(done + missing.clamp(1, done.max(FIRST).max(wanted / LONGEST)))
}

/// Transitions at which a round is broken off: episodes got so much longer in it that it would go far beyond `wanted`.
pub(super) fn too_many(wanted: u64) -> u64 {
    wanted + wanted / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_reach_the_budget_and_pass_it_by_little() {
        // Episodes that get longer while it learns: 10, 11, … 24, then faster.
        let length = |episode: u64| if episode < 300 { 10 + episode / 20 } else { 400.min(10 + (episode - 300) / 2) };
        let (mut decisions, mut rounds) = (Vec::new(), 0);
        while let Some(target) = next_target(&decisions, 25_000) {
            assert!(target > decisions.len() as u64);
            decisions.extend((decisions.len() as u64..target).map(length));
            rounds += 1;
        }
        let total: u64 = decisions.iter().sum();
        assert!(total >= 25_000 && rounds < 12, "{total} transitions in {rounds} rounds");
        assert!(total < too_many(25_000), "{total} transitions");
    }

    #[test]
    fn steady_episodes_are_counted_exactly() {
        assert_eq!(next_target(&[100; 90], 10_000), Some(100));
        assert_eq!(next_target(&[100; 100], 10_000), None);
        assert_eq!((next_target(&[], 10_000), next_target(&[], 1000)), (Some(25), Some(FIRST)));
        assert_eq!(next_target(&[], 0), None);
    }
}
