//! An installed gateway: command line, configuration, services, containers, logs and metrics.

mod command_line;
mod compose;
mod defaults;
mod deploy;
mod logs;
mod mdns;
mod metrics;
pub(crate) mod reload;
mod shutdown;
mod systemd;
