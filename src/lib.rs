//! A gateway that lets many clients share Weiss/SCHUNK WSG grippers safely.

pub mod config;
pub mod frontend;
pub mod gripper;
pub mod sim;
pub mod transport;
pub mod wsg;
