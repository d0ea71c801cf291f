//! Outcomes of episodes.

use crate::{WireError, v1};
use herd_common::episode::{Counts, Ending, Outcome, Reward};

impl From<&Outcome> for v1::Outcome {
    fn from(outcome: &Outcome) -> Self {
        Self {
            ending: outcome.ending.name().to_owned(),
            decisions: outcome.decisions,
            seconds: outcome.seconds,
            reward_velocity: outcome.reward.velocity,
            reward_survival: outcome.reward.survival,
            reward_heading: outcome.reward.heading,
            reward_effort: outcome.reward.effort,
            distance_m: outcome.distance_m,
            roll_variance: outcome.roll_variance,
            pitch_variance: outcome.pitch_variance,
            qp_solves: outcome.counts.qp_solves,
            qp_failures: outcome.counts.qp_failures,
            early_contacts: outcome.counts.early_contacts,
            late_contacts: outcome.counts.late_contacts,
            saturated_torques: outcome.counts.saturated_torques,
        }
    }
}

impl TryFrom<&v1::Outcome> for Outcome {
    type Error = WireError;

    fn try_from(wire: &v1::Outcome) -> Result<Self, WireError> {
        let ending = Ending::from_name(&wire.ending).ok_or_else(|| {
            let known = Ending::ALL.map(|(_, name)| name).join(", ");
            WireError::invalid("outcome.ending", format!("{:?}", wire.ending), format!("one of {known}"))
        })?;
        let outcome = Self {
            ending,
            decisions: wire.decisions,
            seconds: wire.seconds,
            reward: Reward {
                velocity: wire.reward_velocity,
                survival: wire.reward_survival,
                heading: wire.reward_heading,
                effort: wire.reward_effort,
            },
            distance_m: wire.distance_m,
            roll_variance: wire.roll_variance,
            pitch_variance: wire.pitch_variance,
            counts: Counts {
                qp_solves: wire.qp_solves,
                qp_failures: wire.qp_failures,
                early_contacts: wire.early_contacts,
                late_contacts: wire.late_contacts,
                saturated_torques: wire.saturated_torques,
            },
        };
        match outcome.first_invalid() {
            None => Ok(outcome),
            Some((field, value)) => Err(WireError::invalid(field, value, "a finite number of plausible size")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use herd_common::episode::Fall;

    #[test]
    fn outcomes_round_trip_and_bad_ones_are_named() {
        let outcome = Outcome {
            ending: Ending::Fell(Fall::Pitch),
            decisions: 12,
            seconds: 1.5,
            reward: Reward { velocity: 3.0, survival: 2.0, heading: -0.5, effort: -0.25 },
            distance_m: 0.75,
            roll_variance: 1e-4,
            pitch_variance: 2e-4,
            counts: Counts { qp_solves: 75, qp_failures: 1, early_contacts: 2, late_contacts: 3, saturated_torques: 4 },
        };
        let mut wire = v1::Outcome::from(&outcome);
        assert_eq!(Outcome::try_from(&wire).expect("valid"), outcome);
        wire.distance_m = f64::NAN;
        assert!(Outcome::try_from(&wire).expect_err("refused").to_string().starts_with("distance_m is NaN"));
        wire.ending = "tripped".into();
        assert!(Outcome::try_from(&wire).expect_err("refused").to_string().contains("\"tripped\", expected one of"));
    }
}
