//! The integration tests: one binary, each room of it a module.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod invariants;
mod seeds;
mod without_connection;
