//! The integration tests: one binary, each room of it a module.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod architecture;
mod bodies;
mod command_line;
mod commands;
mod compose;
mod conformance;
mod control;
mod defaults;
mod deploy;
mod device;
mod door;
mod ends;
mod fast_stop;
mod first_grip;
mod grips;
mod guides;
mod harness;
mod invariants;
mod journal_files;
mod kills;
mod leases;
mod link;
mod logs;
mod metrics;
mod noisy_udp;
mod recordings;
mod replay;
mod seeds;
mod slow_line;
mod websocket;
mod wires;
mod without_connection;
mod wsg_port;
mod zenoh;
