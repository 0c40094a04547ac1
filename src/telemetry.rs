//! Logs, by `tracing`, on standard error: a frame is TRACE, a change of state INFO, WARN what somebody should look at.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

/// The environment variable that says what is logged, e.g. `debug` or `wsg_gateway::gripper=trace`.
const FILTER_VARIABLE: &str = "WSG_GATEWAY_LOG";

/// Begins to log. A second call does nothing.
pub fn init() {
    let filter = EnvFilter::try_from_env(FILTER_VARIABLE).unwrap_or_else(|_| EnvFilter::new("info"));
    let logs = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    // It fails only where somebody logs already, and then there are logs.
    let _ = logs.with_ansi(std::io::stderr().is_terminal()).try_init();
}
