//! The observation and action spaces as tables: index, meaning, unit, scale.
//!
//! An observation is 56 numbers (paper §3.2), each divided by its scale and clipped to [−1, 1]; the command task shows
//! its command behind them. An action is a point of [−1, 1]ⁿ that the task maps onto its ranges: 4 gait parameters or
//! 12 joint torques.

/// Length of an observation of the paper's tasks.
pub const OBSERVATION_DIM: usize = 56;
/// Length of the longest observation of any task.
pub const OBSERVATION_DIM_MAX: usize = OBSERVATION_DIM + COMMAND.len;
/// Parameters of the gait task: `v_x`, S, H, Δt.
pub const GAIT_ACTION_DIM: usize = 4;
/// Torques of the torque task, in leg order FL, FR, RL, RR, each hip roll, hip pitch, knee.
pub const TORQUE_ACTION_DIM: usize = 12;
/// Legs, in the order FL, FR, RL, RR.
pub const LEGS: usize = 4;

/// One contiguous block of the observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// First index.
    pub start: usize,
    /// Numbers in the block.
    pub len: usize,
    /// What it measures, with its frame.
    pub meaning: &'static str,
    /// Unit before scaling.
    pub unit: &'static str,
    /// The value that maps to 1.
    pub scale: f32,
}

const fn block(start: usize, len: usize, meaning: &'static str, unit: &'static str, scale: f32) -> Block {
    Block { start, len, meaning, unit, scale }
}

/// Centre-of-mass velocity.
pub const VELOCITY: Block = block(0, 3, "trunk velocity x, y, z (world)", "m/s", 2.5);
/// Trunk orientation as a quaternion.
pub const QUATERNION: Block = block(3, 4, "trunk orientation w, x, y, z (world from body)", "1", 1.0);
/// Trunk orientation as angles.
pub const ANGLES: Block = block(7, 3, "roll, pitch, yaw", "rad", 0.35);
/// Torques applied over the last control tick.
pub const TORQUE: Block = block(10, 12, "previous joint torque, FL FR RL RR × roll, pitch, knee", "N·m", 30.0);
/// Sideways position.
pub const POSITION_Y: Block = block(22, 1, "trunk position y (world)", "m", 1.0);
/// Height.
pub const POSITION_Z: Block = block(23, 1, "trunk height over the ground minus the standing height", "m", 0.1);
/// Joint angles relative to the nominal stance.
pub const JOINT_ANGLE: Block = block(24, 12, "joint angle minus nominal, FL FR RL RR × roll, pitch, knee", "rad", 1.0);
/// Joint velocities.
pub const JOINT_VELOCITY: Block = block(36, 12, "joint velocity, FL FR RL RR × roll, pitch, knee", "rad/s", 25.0);
/// Normal contact forces.
pub const NORMAL_FORCE: Block = block(48, 4, "normal ground force, FL FR RL RR", "N", 200.0);
/// Friction forces.
pub const FRICTION_FORCE: Block = block(52, 4, "friction force magnitude, FL FR RL RR", "N", 100.0);

/// What is asked of the robot; behind the paper's numbers, in the command task alone.
pub const COMMAND: Block =
    block(56, 3, "commanded velocity forwards, to the left; yaw rate (heading frame)", "m/s, m/s, rad/s", 1.5);

/// The paper's observation, in index order.
pub const OBSERVATION: [Block; 10] = [
    VELOCITY,
    QUATERNION,
    ANGLES,
    TORQUE,
    POSITION_Y,
    POSITION_Z,
    JOINT_ANGLE,
    JOINT_VELOCITY,
    NORMAL_FORCE,
    FRICTION_FORCE,
];

/// Lengths of a task's spaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dims {
    /// Numbers in an observation.
    pub observation: usize,
    /// Numbers in an action.
    pub action: usize,
}

/// What the policy controls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Task {
    /// The paper's hierarchy (Group_1): four gait parameters, one decision a swing.
    Gait,
    /// The paper's DDPG-only comparison (Group_0): twelve torques every 25 ms.
    Torque,
    /// No learning: the MPC with fixed gait parameters.
    Constant,
    /// Beyond the paper: the gait task for a robot that is told forward, lateral and yaw velocity.
    Command,
}

impl Task {
    /// Every task.
    pub const ALL: [Self; 4] = [Self::Gait, Self::Torque, Self::Constant, Self::Command];

    /// Length of an action; for `Constant` that of the gait action it repeats.
    pub const fn action_dim(self) -> usize {
        match self {
            Self::Gait | Self::Constant | Self::Command => GAIT_ACTION_DIM,
            Self::Torque => TORQUE_ACTION_DIM,
        }
    }

    /// Length of an observation.
    pub const fn observation_dim(self) -> usize {
        match self {
            Self::Gait | Self::Torque | Self::Constant => OBSERVATION_DIM,
            Self::Command => OBSERVATION_DIM_MAX,
        }
    }

    /// Lengths of both spaces.
    pub const fn dims(self) -> Dims {
        Dims { observation: self.observation_dim(), action: self.action_dim() }
    }

    /// The blocks of an observation, in index order.
    pub fn observation(self) -> impl Iterator<Item = Block> {
        OBSERVATION.into_iter().chain((self == Self::Command).then_some(COMMAND))
    }

    /// The name as written in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gait => "gait",
            Self::Torque => "torque",
            Self::Constant => "constant",
            Self::Command => "command",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_tile_the_observation() {
        for task in Task::ALL {
            let end = task.observation().fold(0, |next, block| {
                assert_eq!(block.start, next, "{}", block.meaning);
                assert!(block.scale > 0.0);
                block.start + block.len
            });
            assert_eq!(end, task.observation_dim(), "{}", task.name());
        }
    }
}
