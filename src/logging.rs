//! Logs, by `tracing`, on standard error: a frame is TRACE, a change of state INFO, WARN what somebody should look at.
//!
//! Nobody waits for a log: whoever reads standard error may have stopped reading, and lines that find no place are
//! dropped rather than hold a gripper up.

use std::io::IsTerminal;

use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::EnvFilter;

/// The environment variable that says what is logged, e.g. `debug` or `wsg_gateway::gripper=trace`.
const FILTER_VARIABLE: &str = "WSG_GATEWAY_LOG";

/// What of others' words is logged where nothing else is said: Zenoh repeats each try to connect as a warning.
const OTHERS: &str = "zenoh=warn,zenoh::net::runtime::orchestrator=error";

/// Lines that may wait to be written: some seconds of a busy gateway.
const MAX_WAITING_LINES: usize = 8192;

/// How logs are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum LogFormat {
    /// A line for people, with colours on a terminal
    #[default]
    Text,
    /// A JSON object a line, for machines
    Json,
}

/// Begins to log, until the guard is dropped, which writes what still waits. A second call logs nowhere new.
pub fn init(format: LogFormat) -> WorkerGuard {
    let wanted = std::env::var(FILTER_VARIABLE).ok().filter(|wanted| EnvFilter::try_new(wanted).is_ok());
    let filter = EnvFilter::new(format!("{OTHERS},{}", wanted.as_deref().unwrap_or("info")));
    let writer = NonBlockingBuilder::default().lossy(true).buffered_lines_limit(MAX_WAITING_LINES);
    let (writer, guard) = writer.finish(std::io::stderr());
    let logs = tracing_subscriber::fmt().with_env_filter(filter).with_writer(writer);
    // It fails only where somebody logs already, and then there are logs.
    let _ = match format {
        LogFormat::Text => logs.with_ansi(std::io::stderr().is_terminal()).try_init(),
        LogFormat::Json => logs.json().flatten_event(true).with_span_list(false).try_init(),
    };
    guard
}
