//! Everything that a client can request, defined once for all interfaces.
//!
//! An [`Operation`] has a name, a path, a required right, an urgency, and a function. Each module here, in `gripper` and
//! in `recipes` declares its own, and [`all`] lists them; HTTP paths, WebSocket methods, Zenoh command keys, MQTT topics
//! and the API's documents come from there. `calls` has what all of them use: `run` performs an operation for a
//! `Caller`, and is the one place that records refused requests. `parameters` parses what clients send.
//!
//! Architecture invariant: an operation decides nothing about a gripper. It parses parameters into domain types and
//! hands them to the gripper's handle. The actor refuses what a lease, a latch or a device's limit forbids.

pub(crate) mod alarms;
pub(crate) mod calls;
pub(crate) mod clock;
pub(crate) mod fleet;
mod gateway;
pub(crate) mod gripper;
pub(crate) mod me;
pub(crate) mod parameters;
mod problem;
pub(crate) mod readiness;
pub(crate) mod recipes;
pub(crate) mod records;
pub(crate) mod reload;
mod reload_requests;
pub(crate) mod statistics;
mod table;
pub(crate) mod webhooks;

pub(crate) use crate::model::Code;
pub(crate) use calls::call::{Fields, Params};
pub(crate) use calls::caller::{
    Caller, DEFAULT_WAIT_MS, MAX_LEASE_BYTES, MAX_WAIT_MS, Presence, Wait, WaitLimiter, wait_ms,
};
pub(crate) use calls::connection_lease::ConnectionLease;
pub use calls::operation::Operation;
pub(crate) use calls::operation::journal_command;
pub(crate) use calls::reply::{Effect, OperationReply};
pub(crate) use calls::rights::{check, require};
pub(crate) use calls::run::{call, note_use, run};
pub use gateway::Gateway;
pub(crate) use parameters::query_string::{QueryString, words};
pub(crate) use problem::{Members, Problem};
pub use reload_requests::{ReloadRequest, Reloads};
pub(crate) use table::Method;
pub use table::all;
