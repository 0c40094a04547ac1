//! Integration tests, built as one binary. See `tests/README.md`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod architecture;
mod conformance;
mod device_link;
mod documents;
mod gripper;
mod harness;
mod http;
mod installation;
mod modbus;
mod mqtt;
mod recordings;
mod records;
mod wsg_port;
mod zenoh;
