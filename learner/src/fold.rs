//! n-step returns: an episode's decisions folded, n at a time, into the transitions that are learned from.
//!
//! | symbol | name |
//! |---|---|
//! | r, γ, s′ | reward, discount, next observation of one decision |
//! | n | decisions folded; fewer remain near the end of an episode |
//!
//! The transition that begins with decision t gets `R = Σ_{k<n} (Π_{j<k} γ_{t+j}) r_{t+k}`, the discount
//! `Π_{k<n} γ_{t+k}` and the s′ of the last of them, so that a target is `R + Π γ · Q(s′)`. After a true ending γ is 0 and
//! so is the product; after a time limit the value goes on from where the episode was cut. News of a fall or of a better
//! gait travels n decisions back at each update instead of one (Sutton 1988); what exploration did within the n
//! decisions is taken for the policy's own.

use herd_common::transition::Batch;
use std::borrow::Cow;

/// The transitions of one whole episode, each folded with the up to `n − 1` that follow it.
pub fn fold(episode: &Batch, n: usize) -> Cow<'_, Batch> {
    if n <= 1 {
        return Cow::Borrowed(episode);
    }
    let mut folded = episode.clone();
    let width = episode.next_observations.len() / episode.len().max(1);
    for t in 0..episode.len() {
        let last = (t + n).min(episode.len()) - 1;
        let (mut sum, mut factor) = (0.0, 1.0);
        for k in t..=last {
            sum += factor * episode.rewards[k];
            factor *= episode.discounts[k];
        }
        (folded.rewards[t], folded.discounts[t]) = (sum, factor);
        let seen = &episode.next_observations[last * width..(last + 1) * width];
        folded.next_observations[t * width..(t + 1) * width].copy_from_slice(seen);
    }
    Cow::Owned(folded)
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::spaces::{OBSERVATION_DIM, Task};
    use herd_common::transition::Transition;

    /// Decisions numbered from 1, each worth its number.
    fn episode(discounts: &[f32]) -> Batch {
        let mut batch = Batch::new(Task::Gait.dims());
        for (i, discount) in discounts.iter().enumerate() {
            let number = (i + 1) as f32;
            batch.push(Transition {
                observation: &[number / 10.0; OBSERVATION_DIM],
                action: &[number / 10.0; 4],
                reward: number,
                discount: *discount,
                next_observation: &[(number + 1.0) / 10.0; OBSERVATION_DIM],
            });
        }
        batch
    }

    fn next_numbers(batch: &Batch) -> Vec<f32> {
        batch.next_observations.chunks(OBSERVATION_DIM).map(|row| row[0] * 10.0).collect()
    }

    #[test]
    fn one_step_is_the_episode_itself() {
        let plain = episode(&[0.5, 0.5]);
        assert_eq!(*fold(&plain, 1), plain);
    }

    #[test]
    fn three_steps_by_hand_with_a_fall_at_the_end() {
        let plain = episode(&[0.5, 0.25, 0.5, 0.0]);
        let folded = fold(&plain, 3);
        assert_eq!(folded.rewards, [1.0 + 0.5 * 2.0 + 0.125 * 3.0, 2.0 + 0.25 * 3.0 + 0.125 * 4.0, 3.0 + 2.0, 4.0]);
        assert_eq!(folded.discounts, [0.0625, 0.0, 0.0, 0.0]);
        assert_eq!(next_numbers(&folded), [4.0, 5.0, 5.0, 5.0]);
        assert_eq!((&folded.observations, &folded.actions), (&plain.observations, &plain.actions));
    }

    #[test]
    fn a_time_limit_goes_on_from_where_it_cut() {
        let folded = fold(&episode(&[0.5, 0.5, 0.5]), 8).into_owned();
        assert_eq!(folded.rewards, [1.0 + 1.0 + 0.75, 2.0 + 1.5, 3.0]);
        assert_eq!(folded.discounts, [0.125, 0.25, 0.5]);
    }

    #[test]
    fn an_empty_episode_stays_empty() {
        assert!(fold(&Batch::new(Task::Gait.dims()), 3).is_empty());
    }
}
