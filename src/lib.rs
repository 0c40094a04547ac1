//! A gateway that lets many clients share Weiss/SCHUNK WSG grippers safely.

pub mod gripper;
pub mod transport;
pub mod wsg;
