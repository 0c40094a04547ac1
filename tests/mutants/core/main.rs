//! Tests of these modules on a virtual clock.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod invariants;
mod seeds;
mod without_connection;
