//! Modules that need no interface, journal or configuration.

pub mod gripper;
pub mod sim;
pub mod transport;
pub mod wsg;
