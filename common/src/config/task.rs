//! Settings of the task: action box, reward, endings, discount, reset.

use super::{Error, check, check_span, command};
use crate::spaces::Task;
use serde::{Deserialize, Serialize};

/// What the policy controls and what it is paid for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Which task.
    pub kind: Task,
    /// Time limit T_f, s.
    pub episode_secs: f64,
    /// Stance under joint PD before t = 0, s.
    pub settle_secs: f64,
    /// The box of the gait action.
    pub gait: Gait,
    /// The torque action.
    pub torque: Torque,
    /// The fixed gait of the constant task.
    pub constant: Constant,
    /// The command task.
    pub command: command::Config,
    /// Eq 10.
    pub reward: Reward,
    /// Limits whose breach is a fall.
    pub ending: Ending,
    /// Discount of the next value.
    pub discount: Discount,
    /// Spread of initial states.
    pub reset: Reset,
}

/// Ranges `[lowest, highest]` that the four elements of a gait action map onto.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gait {
    /// Forward velocity `v_x` of the trunk, m/s.
    pub velocity_mps: [f64; 2],
    /// Stride S in the hip frame, m.
    pub stride_m: [f64; 2],
    /// Swing apex H, m.
    pub lift_m: [f64; 2],
    /// Swing duration Δt, s.
    pub step_secs: [f64; 2],
    /// Show the policy a mirrored world when FR + RL swing next.
    pub mirror: bool,
}

/// The torque action (Group_0).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Torque {
    /// Duration of one decision, s.
    pub decision_secs: f64,
    /// Torque at |action| = 1, N·m.
    pub limit_nm: f64,
}

/// One gait, in units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Constant {
    /// Forward velocity `v_x`, m/s.
    pub velocity_mps: f64,
    /// Stride S, m.
    pub stride_m: f64,
    /// Swing apex H, m.
    pub lift_m: f64,
    /// Swing duration Δt, s.
    pub step_secs: f64,
}

/// How torque enters eq 10.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TorqueUnit {
    /// τ over the torque limit, in [−1, 1].
    Normalised,
    /// τ in N·m.
    NewtonMetre,
}

/// Weights of eq 10.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reward {
    /// Per m/s of world v_x.
    pub velocity: f64,
    /// Of T_s / T_f.
    pub survival: f64,
    /// Per rad² of yaw.
    pub heading: f64,
    /// Per squared torque, summed over joints.
    pub effort: f64,
    /// Sampling period T_s, s.
    pub sample_secs: f64,
    /// See [`TorqueUnit`].
    pub torque_unit: TorqueUnit,
}

/// Limits whose breach is a fall.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ending {
    /// Largest |roll|, rad.
    pub roll_rad: f64,
    /// Largest |pitch| beyond what lies between level and parallel to the ground, rad.
    pub pitch_rad: f64,
    /// Largest |yaw| from the heading asked for, which is 0 but for commands, rad.
    pub yaw_rad: f64,
    /// Lowest trunk height over the ground, m.
    pub height_m: f64,
}

/// Over what a discount factor is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Per {
    /// `factor^(Δt / reference_secs)`: long decisions are discounted more.
    Reference,
    /// `factor` per decision, whatever it lasts (paper).
    Decision,
}

/// Discount of the next value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Discount {
    /// α of eq 6.
    pub factor: f64,
    /// See [`Per`].
    pub per: Per,
    /// The duration that `factor` belongs to, s.
    pub reference_secs: f64,
}

/// Spread of initial states: uniform within ± these.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reset {
    /// Joint angles, rad.
    pub joint_rad: f64,
    /// Yaw, rad.
    pub yaw_rad: f64,
    /// Horizontal trunk velocity, m/s.
    pub velocity_mps: f64,
}

impl Discount {
    /// The discount of a decision of this duration.
    pub fn of(&self, decision_secs: f64) -> f64 {
        match self.per {
            Per::Reference => self.factor.powf(decision_secs / self.reference_secs),
            Per::Decision => self.factor,
        }
    }
}

impl Gait {
    /// The gait that an action in [−1, 1]⁴ (`v_x`, S, H, Δt) stands for.
    pub fn from_action(&self, action: &[f32]) -> Constant {
        let at = |i: usize, [lowest, highest]: [f64; 2]| {
            lowest + (highest - lowest) * (f64::from(action[i]).clamp(-1.0, 1.0) + 1.0) / 2.0
        };
        Constant {
            velocity_mps: at(0, self.velocity_mps),
            stride_m: at(1, self.stride_m),
            lift_m: at(2, self.lift_m),
            step_secs: at(3, self.step_secs),
        }
    }
}

impl Config {
    /// What names the task: only the constant task depends on the constant gait, only the command task on commands.
    pub(super) fn identity(&self) -> Self {
        let still = Constant { velocity_mps: 0.0, stride_m: 0.0, lift_m: 0.0, step_secs: 0.0 };
        Self {
            constant: if self.kind == Task::Constant { self.constant } else { still },
            command: if self.kind == Task::Command { self.command.clone() } else { command::Config::default() },
            ..self.clone()
        }
    }

    pub(super) fn validate(&self) -> Result<(), Error> {
        check("task.episode_secs", self.episode_secs, 0.1..=1000.0)?;
        check("task.settle_secs", self.settle_secs, 0.0..=10.0)?;
        check_span("task.gait.velocity_mps", self.gait.velocity_mps, -5.0..=5.0)?;
        check_span("task.gait.stride_m", self.gait.stride_m, -0.5..=0.5)?;
        check_span("task.gait.lift_m", self.gait.lift_m, 0.0..=0.15)?;
        check_span("task.gait.step_secs", self.gait.step_secs, 0.05..=1.0)?;
        check("task.torque.decision_secs", self.torque.decision_secs, 0.002..=1.0)?;
        check("task.torque.limit_nm", self.torque.limit_nm, 0.0..=1000.0)?;
        check("task.constant.velocity_mps", self.constant.velocity_mps, -5.0..=5.0)?;
        check("task.constant.stride_m", self.constant.stride_m, -0.5..=0.5)?;
        check("task.constant.lift_m", self.constant.lift_m, 0.0..=0.15)?;
        check("task.constant.step_secs", self.constant.step_secs, 0.05..=1.0)?;
        self.command.validate()?;
        check("task.reward.sample_secs", self.reward.sample_secs, 0.002..=1.0)?;
        check("task.ending.roll_rad", self.ending.roll_rad, 0.0..=3.2)?;
        check("task.ending.pitch_rad", self.ending.pitch_rad, 0.0..=3.2)?;
        check("task.ending.yaw_rad", self.ending.yaw_rad, 0.0..=3.2)?;
        check("task.ending.height_m", self.ending.height_m, 0.0..=1.0)?;
        check("task.discount.factor", self.discount.factor, 0.0..=1.0)?;
        check("task.discount.reference_secs", self.discount.reference_secs, 1e-3..=100.0)?;
        check("task.reset.joint_rad", self.reset.joint_rad, 0.0..=0.5)?;
        check("task.reset.yaw_rad", self.reset.yaw_rad, 0.0..=0.5)?;
        check("task.reset.velocity_mps", self.reset.velocity_mps, 0.0..=1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_discount_counts_time_or_decisions() {
        let by = |per| Discount { factor: 0.9, per, reference_secs: 0.1 };
        assert!((by(Per::Reference).of(0.1) - 0.9).abs() < 1e-15);
        assert!((by(Per::Reference).of(0.2) - 0.81).abs() < 1e-15);
        assert!([0.1, 0.2].iter().all(|secs| by(Per::Decision).of(*secs) == 0.9));
    }
}
