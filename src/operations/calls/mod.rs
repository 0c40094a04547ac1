//! How an operation is declared, called by a client, checked, run, answered and audited.

pub mod audit;
pub(super) mod call;
pub(super) mod caller;
pub(super) mod connection_lease;
pub mod contract;
pub(super) mod durable_changes;
pub(super) mod handler;
pub(super) mod operation;
pub(crate) mod problem_sets;
pub(super) mod reply;
pub(super) mod rights;
pub(super) mod run;
