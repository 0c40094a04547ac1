//! Attacks on the gateway, to show that a FAST STOP gets through meanwhile. Each has a probe of every interface, a
//! poller that must lose nothing, and a device independent of the simulator. Each prints a row of figures.
//!
//! Excluded from plain `cargo test`, since they take minutes and the whole machine. Run them with `cargo test --test
//! attacks every_run:: -- --test-threads=1 --nocapture`, or without `every_run::` for all of them. The attackers open
//! up to 4,000 connections, which the hard limit of file descriptors has to allow.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

#[path = "../suite/harness/mod.rs"]
#[allow(dead_code, unused_imports, reason = "parts used only by other tests")]
mod harness;

#[path = "../suite/mqtt/broker.rs"]
#[allow(dead_code, reason = "parts used only by other tests")]
mod broker;

mod attack;
mod attacker;
mod device;
mod every_run;
mod gateway;
mod http;
mod long;
mod mqtt;
mod poller;
mod probe;
mod websocket;
