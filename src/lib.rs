//! A gateway that lets many clients share Weiss/SCHUNK WSG grippers safely.

pub mod sim;
pub mod wsg;
