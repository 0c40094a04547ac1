//! Tests of the crates that need no interface, journal or configuration, on a virtual clock: invariants, and
//! random schedules.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod invariants;
mod seeds;
mod without_connection;
