//! Everything that a client can request, defined once for all interfaces.
//!
//! An [`Operation`] has a name, a path, a required right, an urgency, and a function. Each
//! module declares its own, and [`all`] lists them; HTTP paths, WebSocket methods, Zenoh command keys and the API's
//! documents come from there. `run` performs an operation
//! for a `Caller`, and is the one place that records refused requests.
//!
//! Architecture invariant: an operation decides nothing about a gripper. It parses parameters into domain types and
//! hands them to the gripper's handle. The actor refuses what a lease, a latch or a device's limit forbids.

pub(crate) mod alarms;
pub mod audit;
mod call;
mod caller;
pub(crate) mod clock;
pub(crate) mod commands;
pub(crate) mod connection;
mod connection_lease;
pub mod contract;
pub(crate) mod copy_recipes;
pub(crate) mod device;
mod durable;
pub(crate) mod fast_stop;
pub(crate) mod finger_set;
pub(crate) mod fingers;
pub(crate) mod fleet;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz;
mod gateway;
pub(crate) mod grippers;
mod handler;
pub(crate) mod json;
pub(crate) mod lease;
pub(crate) mod me;
pub(crate) mod motion;
pub(crate) mod nearest;
mod operation;
mod problem;
pub(crate) mod problem_sets;
mod query_string;
pub(crate) mod raw;
pub(crate) mod readiness;
pub(crate) mod recipes;
pub(crate) mod records;
pub(crate) mod reload;
mod reload_requests;
mod reply;
mod requested_recipe;
mod rights;
mod run;
pub(crate) mod servo;
pub(crate) mod settings;
pub(crate) mod statistics;
mod table;
pub(crate) mod teach;
pub(crate) mod values;
pub(crate) mod webhooks;

pub(crate) use crate::model::Code;
pub(crate) use call::{Fields, Params};
pub(crate) use caller::{Caller, DEFAULT_WAIT_MS, MAX_LEASE_BYTES, MAX_WAIT_MS, Presence, Wait, WaitLimiter, wait_ms};
pub(crate) use connection_lease::ConnectionLease;
pub use gateway::Gateway;
pub use operation::Operation;
pub(crate) use operation::journal_command;
pub(crate) use problem::{Members, Problem};
pub(crate) use query_string::{QueryString, words};
pub use reload_requests::{ReloadRequest, Reloads};
pub(crate) use reply::{Effect, OperationReply};
pub(crate) use rights::{check, require};
pub(crate) use run::{call, note_use, run};
pub(crate) use table::Method;
pub use table::all;
