//! A piece of an episode in the form in which it travels: packed once, sent as often as wanted without copying a number.

use crate::{convert, v1};
use herd_common::transition::Batch;
use herd_common::work::Work;

/// Transitions as columns of bytes; a clone shares them.
#[derive(Clone, Debug, PartialEq)]
pub struct Packed(v1::Transitions);

impl Packed {
    /// The transitions of `batch`.
    pub fn new(batch: &Batch) -> Self {
        Self(convert::transitions_to_wire(Work::Episode(0), 0, 0, batch))
    }

    /// The same transitions with other rewards, one each.
    pub fn with_rewards(&self, rewards: &[f32]) -> Self {
        assert_eq!(rewards.len(), self.len(), "one reward a transition");
        Self(v1::Transitions { rewards: convert::column(rewards), ..self.0.clone() })
    }

    /// Transitions held.
    pub fn len(&self) -> usize {
        self.0.count as usize
    }

    /// True when it holds none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The message that makes it the piece from `first` on of a leased episode.
    pub(crate) fn addressed(self, work: Work, attempt: u32, first: u64) -> v1::Transitions {
        v1::Transitions { work: Some(work.into()), attempt, first, ..self.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::spaces::{OBSERVATION_DIM, Task};
    use herd_common::transition::Transition;

    #[test]
    fn it_is_the_message_of_its_batch_with_the_rewards_given() {
        let mut batch = Batch::new(Task::Gait.dims());
        let (observation, next_observation) = (&[0.5; OBSERVATION_DIM], &[0.25; OBSERVATION_DIM]);
        for reward in [1.0, 2.0] {
            batch.push(Transition { observation, action: &[0.1; 4], reward, discount: 0.9, next_observation });
        }
        let message = Packed::new(&batch).with_rewards(&[3.0, 4.0]).addressed(Work::Episode(7), 2, 5);
        batch.rewards = vec![3.0, 4.0];
        assert_eq!(message, convert::transitions_to_wire(Work::Episode(7), 2, 5, &batch));
        assert_eq!(Packed::new(&batch).len(), 2);
    }
}
