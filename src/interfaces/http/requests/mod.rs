//! Requests: checked, paced, translated to operations, forwarded to other gateways, logged, and answered.

pub(super) mod access_log;
pub(super) mod audit;
pub(super) mod body;
pub(super) mod fast_stop;
pub(super) mod forward;
pub(super) mod guard;
pub(super) mod large_responses;
pub(super) mod operation;
mod origin;
mod problem;
pub(super) mod refused_sockets;
pub(super) mod request_admission;
pub(super) mod requested_operation;
pub(super) mod rights;
pub(super) mod unknown_path;
pub(super) mod visitor;
mod waits;
