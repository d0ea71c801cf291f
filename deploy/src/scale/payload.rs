//! What a synthetic actor sends: episodes without physics, packed once and stamped per episode.

use herd_common::episode::{Counts, Ending, Outcome, Reward};
use herd_common::spaces::Dims;
use herd_common::transition::{Batch, Transition};
use herd_proto::packed::Packed;

/// Episodes that differ in every number; each is sent many times with rewards of its own.
const VARIANTS: u64 = 8;
/// Rewards stay whole numbers below this, so that f32 holds each of them exactly.
const REWARDS: u64 = 1_000_000;

/// Prepared episodes of one length.
pub(crate) struct Payload {
    decisions: u64,
    /// The pieces of each variant.
    variants: Vec<Vec<Packed>>,
}

impl Payload {
    /// Episodes of `decisions` transitions, in pieces of at most `piece`, for spaces of these lengths.
    pub(crate) fn new(decisions: usize, piece: usize, dims: Dims) -> Self {
        let variant = |variant: u64| {
            let indices: Vec<usize> = (0..decisions).collect();
            indices.chunks(piece).map(|chunk| Packed::new(&batch(variant, chunk, dims))).collect()
        };
        Self { decisions: decisions as u64, variants: (0..VARIANTS).map(variant).collect() }
    }

    /// Transitions of an episode.
    pub(crate) fn decisions(&self) -> u64 {
        self.decisions
    }

    /// The pieces of an episode, each with the index of its first transition; no two episodes are the same.
    pub(crate) fn episode(&self, episode: u64) -> impl Iterator<Item = (u64, Packed)> + '_ {
        let mut first = 0;
        self.variants[(episode % VARIANTS) as usize].iter().map(move |piece| {
            let from = episode * self.decisions + first;
            let rewards: Vec<f32> = (from..from + piece.len() as u64).map(|i| (i % REWARDS) as f32).collect();
            let at = first;
            first += piece.len() as u64;
            (at, piece.with_rewards(&rewards))
        })
    }

    /// How an episode ended.
    pub(crate) fn outcome(&self) -> Outcome {
        Outcome {
            ending: Ending::TimedOut,
            decisions: self.decisions,
            seconds: 1.0,
            reward: Reward::default(),
            distance_m: 0.0,
            roll_variance: 0.0,
            pitch_variance: 0.0,
            counts: Counts::default(),
        }
    }
}

/// Transitions whose numbers differ with variant, index and place, all within [-1, 1].
fn batch(variant: u64, indices: &[usize], dims: Dims) -> Batch {
    let mut batch = Batch::new(dims);
    let number = |index: usize, place: usize| {
        let whole = (variant as usize * 31 + index * 17 + place * 7) % 2001;
        whole as f32 / 1000.0 - 1.0
    };
    for &index in indices {
        let seen: Vec<f32> = (0..dims.observation).map(|place| number(index, place)).collect();
        let next: Vec<f32> = (0..dims.observation).map(|place| number(index + 1, place)).collect();
        let action: Vec<f32> = (0..dims.action).map(|place| number(index, place + dims.observation)).collect();
        let (observation, action, next_observation) = (&seen[..], &action[..], &next[..]);
        batch.push(Transition { observation, action, reward: 0.0, discount: 0.95, next_observation });
    }
    batch
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::spaces::Task;

    #[test]
    fn episodes_are_valid_whole_and_distinct() {
        let all: Vec<usize> = (0..100).collect();
        let dims = Task::Gait.dims();
        assert_eq!(batch(3, &all, dims).validate(), Ok(()));
        assert_ne!(batch(3, &all, dims), batch(4, &all, dims));
        let payload = Payload::new(100, 32, dims);
        let pieces: Vec<(u64, usize)> = payload.episode(5).map(|(first, piece)| (first, piece.len())).collect();
        assert_eq!(pieces, [(0, 32), (32, 32), (64, 32), (96, 4)]);
        let one: Vec<_> = payload.episode(1).collect();
        assert_ne!(one, payload.episode(1 + VARIANTS).collect::<Vec<_>>(), "rewards tell episodes apart");
    }
}
