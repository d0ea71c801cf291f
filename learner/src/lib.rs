//! The learner wing of herd: replay, DDPG and policy export.

pub mod ddpg;
pub mod export;
pub mod replay;
