//! The actor wing of herd: the robot, its controllers and its simulation, each a core without clock or I/O.

pub mod mpc;
