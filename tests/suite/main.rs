//! Integration tests, built as one binary. See `tests/README.md`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod access;
mod alarms;
mod architecture;
mod backups;
mod bodies;
mod command_line;
mod commands;
mod compose;
mod conformance;
mod control;
mod defaults;
mod deploy;
mod device;
mod fast_stop;
mod first_grip;
mod foreign_protocols;
mod generated_names;
mod grip_records;
mod guides;
mod harness;
mod host_and_origin;
mod journal_files;
mod kills;
mod leases;
mod link;
mod logs;
mod mdns;
mod metrics;
mod modbus;
mod noisy_udp;
mod recipes;
mod recordings;
mod reload;
mod replay;
mod shutdown;
mod slow_line;
mod systemd;
mod transports;
mod wear;
mod webhooks;
mod websocket;
mod websocket_stops;
mod wsg_port;
mod zenoh;
