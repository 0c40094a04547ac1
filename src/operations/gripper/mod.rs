//! Operations on one gripper, or on the grippers of this gateway.

pub(crate) mod commands;
pub(crate) mod connection;
pub(crate) mod device;
pub(crate) mod device_settings;
pub(crate) mod fast_stop;
pub(crate) mod finger_set;
pub(crate) mod fingers;
pub(crate) mod grippers;
pub(crate) mod lease;
pub(crate) mod motion;
pub(crate) mod raw;
pub(crate) mod servo;
