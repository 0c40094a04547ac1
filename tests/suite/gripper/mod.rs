//! What clients can do with a gripper: commands, leases, FAST STOP, recipes and fingers.

mod commands;
mod control;
mod device;
mod fast_stop;
mod first_grip;
mod leases;
mod recipes;
mod servo;
mod wear;
