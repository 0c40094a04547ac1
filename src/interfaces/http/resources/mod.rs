//! Resources that only HTTP has: the journal's pages, streams, recipes as CSV, sessions, tickets, and the gateway's
//! health.

pub(super) mod fleet_lists;
pub(super) mod gateway;
pub(super) mod journal;
pub(super) mod recipes;
pub(super) mod session;
pub(super) mod stream;
pub(super) mod tickets;
pub(super) mod upgrade;
