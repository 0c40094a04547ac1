//! Logs on standard error, with `tracing`. Frames are TRACE, changes of state INFO, and WARN needs someone's attention.
//!
//! Logging never blocks. If standard error is not read, lines that do not fit the queue are dropped, so that no gripper
//! is delayed.

use std::fmt;
use std::io::IsTerminal;
use std::os::linux::fs::MetadataExt as _;

use tracing::{Event, Level, Subscriber};
use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format::{Format, Full, Writer};
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::registry::LookupSpan;

/// Environment variable with the log filter, e.g. `debug` or `wsg_gateway::gripper=trace`.
const FILTER_VARIABLE: &str = "WSG_GATEWAY_LOG";

/// Default filter for other crates. Zenoh logs each attempt to connect as a warning.
const OTHERS: &str = "zenoh=warn,zenoh::net::runtime::orchestrator=error";

/// Lines that can wait to be written: some seconds of a busy gateway.
const MAX_WAITING_LINES: usize = 8192;

/// Format of the logs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum LogFormat {
    /// Text for people, with colours on a terminal, and with priorities in place of times in systemd's journal
    #[default]
    Text,
    /// One JSON object per line, for machines
    Json,
}

/// Starts logging. Dropping the guard writes the waiting lines and ends the logging. A second call changes nothing.
pub fn init(format: LogFormat) -> WorkerGuard {
    let wanted = std::env::var(FILTER_VARIABLE).ok().filter(|wanted| EnvFilter::try_new(wanted).is_ok());
    let filter = EnvFilter::new(format!("{OTHERS},{}", wanted.as_deref().unwrap_or("info")));
    let writer = NonBlockingBuilder::default().lossy(true).buffered_lines_limit(MAX_WAITING_LINES);
    let (writer, guard) = writer.finish(std::io::stderr());
    let logs = tracing_subscriber::fmt().with_env_filter(filter).with_writer(writer);
    // Fails only if logging was set up already, and then there are logs.
    let _ = match format {
        LogFormat::Text if writes_to_systemd() => {
            logs.event_format(WithPriority(Format::default().without_time().with_ansi(false))).try_init()
        }
        LogFormat::Text => logs.with_ansi(std::io::stderr().is_terminal()).try_init(),
        LogFormat::Json => logs.json().flatten_event(true).with_span_list(false).try_init(),
    };
    guard
}

/// Whether standard error is systemd's journal (systemd.exec(5), `JOURNAL_STREAM`).
fn writes_to_systemd() -> bool {
    let stream = std::env::var("JOURNAL_STREAM").ok();
    let error = std::fs::metadata("/proc/self/fd/2").ok();
    error.is_some_and(|file| stream == Some(format!("{}:{}", file.st_dev(), file.st_ino())))
}

/// Starts each line with its priority, as systemd's journal expects (sd-daemon(3)).
struct WithPriority(Format<Full, ()>);

impl<S, N> FormatEvent<S, N> for WithPriority
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(&self, context: &FmtContext<'_, S, N>, mut writer: Writer<'_>, event: &Event<'_>) -> fmt::Result {
        let priority = match *event.metadata().level() {
            Level::ERROR => 3,
            Level::WARN => 4,
            Level::INFO => 6,
            _ => 7,
        };
        write!(writer, "<{priority}>")?;
        self.0.format_event(context, writer, event)
    }
}
