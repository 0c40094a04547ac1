//! A gateway that lets many clients share Weiss/SCHUNK WSG grippers safely.

pub mod cli;
pub mod config;
pub mod daemon;
pub mod frontend;
pub mod gripper;
pub mod sim;
pub mod telemetry;
pub mod transport;
pub mod wsg;
