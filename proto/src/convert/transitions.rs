//! Transitions: columns on both sides, checked for shape and value on the way in.

use super::numbers::{from_bytes, to_bytes};
use crate::{WireError, v1};
use herd_common::spaces::Dims;
use herd_common::transition::Batch;
use herd_common::{caps, work::Work};

/// A piece of an episode, ready to send.
pub fn transitions_to_wire(work: Work, attempt: u32, first: u64, batch: &Batch) -> v1::Transitions {
    v1::Transitions {
        work: Some(work.into()),
        attempt,
        first,
        count: batch.len() as u32,
        observations: to_bytes(&batch.observations),
        actions: to_bytes(&batch.actions),
        rewards: to_bytes(&batch.rewards),
        discounts: to_bytes(&batch.discounts),
        next_observations: to_bytes(&batch.next_observations),
    }
}

/// The columns of a message, for a task whose spaces have these lengths.
pub fn transitions_from_wire(message: &v1::Transitions, dims: Dims) -> Result<Batch, WireError> {
    let n = message.count as usize;
    if n == 0 || n > caps::TRANSITIONS_PER_MESSAGE {
        return Err(WireError::invalid("count", n, format!("1 to {}", caps::TRANSITIONS_PER_MESSAGE)));
    }
    let batch = Batch {
        observation_dim: dims.observation,
        action_dim: dims.action,
        observations: from_bytes("observations", &message.observations, n * dims.observation)?,
        actions: from_bytes("actions", &message.actions, n * dims.action)?,
        rewards: from_bytes("rewards", &message.rewards, n)?,
        discounts: from_bytes("discounts", &message.discounts, n)?,
        next_observations: from_bytes("next_observations", &message.next_observations, n * dims.observation)?,
    };
    batch.validate()?;
    Ok(batch)
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::spaces::Task;
    use herd_common::transition::Transition;
    use proptest::prelude::*;

    fn batch(task: Task, n: usize, value: f32) -> Batch {
        let dims = task.dims();
        let mut batch = Batch::new(dims);
        for i in 0..n {
            batch.push(Transition {
                observation: &vec![value; dims.observation],
                action: &vec![-value; dims.action],
                reward: i as f32,
                discount: 0.5,
                next_observation: &vec![value * 0.5; dims.observation],
            });
        }
        batch
    }

    proptest! {
        #[test]
        fn round_trip(task in 0..4_usize, n in 1_usize..40, value in -1.0_f32..1.0, first in 0_u64..1000) {
            let task = Task::ALL[task];
            let message = transitions_to_wire(Work::Episode(7), 2, first, &batch(task, n, value));
            prop_assert_eq!(message.first, first);
            prop_assert_eq!(transitions_from_wire(&message, task.dims()).expect("valid"), batch(task, n, value));
        }
    }

    #[track_caller]
    fn refused(damage: impl FnOnce(&mut v1::Transitions), expected: &str) {
        let mut message = transitions_to_wire(Work::Episode(7), 2, 0, &batch(Task::Gait, 3, 0.25));
        damage(&mut message);
        let error = transitions_from_wire(&message, Task::Gait.dims()).expect_err("refused").to_string();
        assert!(error.contains(expected), "{error}");
    }

    #[test]
    fn bad_messages_are_refused_by_name() {
        refused(|m| m.count = 0, "count is 0, expected 1 to 4096");
        refused(|m| m.count = u32::MAX, "count is 4294967295");
        refused(|m| m.actions = m.actions.slice(..47), "actions is 47 bytes, expected 48 (12 numbers)");
        refused(|m| m.rewards = to_bytes(&[0.0, f32::NAN, 0.0]), "reward[0] of transition 1 is NaN");
        refused(|m| m.actions = to_bytes(&[2.0; 12]), "action[0] of transition 0 is 2");
        let wide = transitions_to_wire(Work::Episode(7), 2, 0, &batch(Task::Command, 3, 0.25)).observations;
        refused(|m| m.observations = wide, "observations is 708 bytes, expected 672 (168 numbers)");
    }
}
