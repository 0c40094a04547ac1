//! `wsg-gateway journal`: lists, follows, exports, verifies and copies the records of a journal file.

use std::io::{self, BufWriter, IsTerminal as _, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::{Args, Subcommand, ValueEnum};
use serde::de::DeserializeOwned;

use crate::config::JournalFlags;
use crate::journal::csv::{EVENT_COLUMNS, GRIP_COLUMNS, header, lines};
use crate::journal::{
    Cursor, EventQuery, Filter, GripQuery, Head, Limit, Order, Page, Query, ReadError, Reader, Report, back_up,
    is_in_use, verify_with_progress,
};
use progress::ProgressLine;

mod line;
mod progress;

/// Interval between polls for new events.
const POLL: Duration = Duration::from_millis(200);

/// Records listed without `--limit`.
const LISTED: u64 = 100;

/// Records read at once.
const PAGE: u64 = 1000;

#[derive(Debug, Args)]
pub(super) struct JournalArgs {
    #[command(flatten)]
    flags: JournalFlags,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Print records, one per line; by default the newest 100
    List {
        #[command(flatten)]
        which: Which,
    },
    /// Print each event as it becomes durable
    Follow {
        /// Begin after the event with this sequence number instead of with the next new event
        #[arg(long, value_name = "SEQ")]
        after: Option<u64>,
        #[command(flatten)]
        filters: Filters,
    },
    /// Write records with all their fields, oldest first
    Export {
        /// json: one object per line; csv: a header, then one line per record
        #[arg(long, value_enum, default_value_t)]
        format: Format,
        #[command(flatten)]
        which: Which,
    },
    /// Check that no record was changed or removed since it was written; exits with 1 if any was
    Verify {
        /// Earlier head, as `head` prints it: its records must be there, or have been removed as too old
        #[arg(long, value_name = "HEAD")]
        head: Option<Head>,
    },
    /// Print the newest event and grip record with their hashes, to keep elsewhere: without it, nothing shows that the
    /// newest records and the file of the head were removed
    Head,
    /// Copy the journal to a new file, which `verify` can check
    Backup {
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Format {
    #[default]
    Json,
    Csv,
}

#[derive(Debug, Args)]
struct Which {
    /// Read grip records instead of events: of all kinds, unless --kind names one
    #[arg(long)]
    grips: bool,
    #[command(flatten)]
    filters: Filters,
    /// Maximum number of records
    #[arg(long, value_name = "N")]
    limit: Option<u64>,
    /// Order of the records: newest or oldest first
    #[arg(long, value_name = "ORDER")]
    order: Option<String>,
}

#[derive(Debug, Args)]
struct Filters {
    /// Only records of this gripper
    #[arg(long, value_name = "NAME")]
    gripper: Option<String>,
    /// Only records of this kind: command, fast_stop, acknowledge, lease, link, device, settings, refused, alarm, recipe
    /// or gateway; with --grips home, move, grip, release or reference
    #[arg(long)]
    kind: Option<String>,
    /// Only records of this part
    #[arg(long, value_name = "PART")]
    part_id: Option<String>,
    /// Only records with this outcome, e.g. PART_HELD or NO_PART
    #[arg(long)]
    outcome: Option<String>,
    /// Only records of this command
    #[arg(long, value_name = "ID")]
    command_id: Option<String>,
    /// Only records from this time on, e.g. 2026-11-21T09:00:00Z
    #[arg(long, value_name = "TIME")]
    from: Option<String>,
    /// Only records before this time
    #[arg(long, value_name = "TIME")]
    to: Option<String>,
}

impl Filters {
    fn query<K: DeserializeOwned>(&self) -> anyhow::Result<Query<K>> {
        let outcome = self.outcome.as_ref().map(|outcome| outcome.to_uppercase());
        let filter = Filter {
            gripper: value("--gripper", self.gripper.as_ref())?,
            kind: value("--kind", self.kind.as_ref())?,
            part_id: value("--part-id", self.part_id.as_ref())?,
            part_prefix: None,
            outcome: value("--outcome", outcome.as_ref())?,
            command_id: value("--command-id", self.command_id.as_ref())?,
        };
        let from = value("--from", self.from.as_ref())?;
        let to = value("--to", self.to.as_ref())?;
        Ok(Query { filter, from, to, ..Query::default() })
    }
}

/// Parses a flag's value by its name in JSON.
fn value<T: DeserializeOwned>(flag: &str, text: Option<&String>) -> anyhow::Result<Option<T>> {
    let Some(text) = text else { return Ok(None) };
    serde_json::from_value::<T>(text.clone().into()).map(Some).with_context(|| format!("{flag} {text}"))
}

pub(super) fn run(journal: &JournalArgs, out: impl Write) -> anyhow::Result<()> {
    let path = journal.flags.path()?;
    let mut out = BufWriter::new(out);
    let result = match &journal.command {
        Command::List { which } => {
            let limit = which.limit.unwrap_or(LISTED);
            each_page(&Reader::open(&path)?, which, Order::Newest, limit, |bodies| list(&mut out, bodies))
                .map(|count| report_none(count, &path))
        }
        Command::Follow { after, filters } => follow(&Reader::open(&path)?, *after, filters, &mut out),
        Command::Export { format, which } => {
            export(&Reader::open(&path)?, *format, which, &mut out).map(|count| report_none(count, &path))
        }
        Command::Verify { head } => check(&path, *head, &mut out),
        Command::Head => Reader::open(&path)?.head().map_err(Into::into).and_then(|head| Ok(writeln!(out, "{head}")?)),
        Command::Backup { file } => check_gateway(&journal.flags, &path).and_then(|()| copy(&path, file, &mut out)),
    };
    match result.and_then(|()| Ok(out.flush()?)) {
        // The reader of standard output may stop early.
        Err(error)
            if error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe) =>
        {
            Ok(())
        }
        result => result,
    }
}

/// Says on standard error if there were no records, since the journal may be the wrong one.
fn report_none(count: u64, path: &Path) {
    if count == 0 {
        let path = path.display();
        let _ = writeln!(
            io::stderr(),
            "no records match in {path}: for another journal, pass --journal PATH or --name NAME"
        );
    }
}

fn list(out: &mut impl Write, bodies: &[Arc<str>]) -> io::Result<()> {
    bodies.iter().try_for_each(|body| writeln!(out, "{}", line::of(body)))
}

fn export(reader: &Reader, format: Format, which: &Which, out: &mut impl Write) -> anyhow::Result<u64> {
    let limit = which.limit.unwrap_or(u64::MAX);
    let columns = if which.grips { GRIP_COLUMNS } else { EVENT_COLUMNS };
    if format == Format::Csv {
        out.write_all(header(columns).as_bytes())?;
    }
    // On a terminal, the records show the progress themselves.
    let mut progress = ProgressLine::new("exported", !io::stdout().is_terminal());
    let mut written = 0;
    each_page(reader, which, Order::Oldest, limit, |bodies| {
        written += bodies.len();
        progress.show(format_args!("{written} records"));
        match format {
            Format::Json => bodies.iter().try_for_each(|body| writeln!(out, "{body}")),
            Format::Csv => out.write_all(lines(columns, bodies.iter().map(|body| &**body)).as_bytes()),
        }
    })
}

/// Writes page after page until `limit` is reached or the records end. Returns the number of records.
fn each_page(
    reader: &Reader,
    which: &Which,
    order: Order,
    limit: u64,
    write: impl FnMut(&[Arc<str>]) -> io::Result<()>,
) -> anyhow::Result<u64> {
    let order = value("--order", which.order.as_ref())?.unwrap_or(order);
    if which.grips {
        let query = GripQuery { order, ..which.filters.query()? };
        pages(query, limit, |query| reader.grips(query), write)
    } else {
        let query = EventQuery { order, ..which.filters.query()? };
        pages(query, limit, |query| reader.events(query), write)
    }
}

fn pages<K>(
    mut query: Query<K>,
    mut limit: u64,
    read: impl Fn(&Query<K>) -> Result<Page, ReadError>,
    mut write: impl FnMut(&[Arc<str>]) -> io::Result<()>,
) -> anyhow::Result<u64> {
    let mut count = 0;
    while limit > 0 {
        query.limit = Limit::new(limit.min(PAGE))?;
        let page = read(&query)?;
        write(&page.bodies)?;
        limit -= page.bodies.len() as u64;
        count += page.bodies.len() as u64;
        match page.next_cursor {
            Some(cursor) => query.cursor = Some(cursor.parse()?),
            None => break,
        }
    }
    Ok(count)
}

fn follow(reader: &Reader, after: Option<u64>, filters: &Filters, out: &mut impl Write) -> anyhow::Result<()> {
    let mut query = EventQuery { order: Order::Oldest, ..filters.query()? };
    let mut after = match after {
        Some(after) => i64::try_from(after)?,
        None => reader.last_seq()?,
    };
    loop {
        // Events that arrive during the read belong to the next round.
        let last = reader.last_seq()?;
        query.cursor = Some(Cursor::after(after));
        pages(query.clone(), u64::MAX, |query| reader.events_until(query, last), |bodies| list(out, bodies))?;
        out.flush()?;
        after = after.max(last);
        std::thread::sleep(POLL);
    }
}

/// Checks that a journal that no flag names belongs to the gateway that runs, if one does.
fn check_gateway(flags: &JournalFlags, path: &Path) -> anyhow::Result<()> {
    if !flags.is_default() {
        return Ok(());
    }
    let beside = path.parent().map(std::fs::read_dir).into_iter().flatten().flatten().flatten();
    let journals =
        beside.map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|ending| ending == "db"));
    let mut used: Vec<_> = journals.filter(|path| is_in_use(path) == Some(true)).collect();
    used.sort();
    if used.is_empty() || used == [path] {
        return Ok(());
    }
    let used: Vec<_> = used.iter().map(|path| path.display().to_string()).collect();
    bail!("gateways write to {}: name one of these files with --journal, or its gateway with --name", used.join(", "))
}

fn copy(path: &Path, to: &Path, out: &mut impl Write) -> anyhow::Result<()> {
    let mut progress = ProgressLine::new("copied", true);
    let mut bytes = 0;
    back_up(path, to, |copied, all| {
        bytes = all;
        progress.show_part(copied, all);
    })?;
    drop(progress);
    let to = to.display();
    let use_now = if is_in_use(path) == Some(true) {
        "a gateway is writing to it"
    } else {
        "no gateway uses it now; if yours runs with --journal or --config, name that here too"
    };
    writeln!(out, "from {} ({use_now})", path.display())?;
    Ok(writeln!(out, "{to}: {bytes} bytes copied; check the copy with `wsg-gateway journal verify --journal {to}`")?)
}

fn check(path: &Path, head: Option<Head>, out: &mut impl Write) -> anyhow::Result<()> {
    let mut progress = ProgressLine::new("verified", true);
    let report = verify_with_progress(path, head, |read, all| progress.show_part(read, all))?;
    drop(progress);
    report.findings.iter().try_for_each(|finding| writeln!(out, "{finding}"))?;
    let found = report.findings.len() as u64 + report.more;
    let Report { events, grips, memories, .. } = report;
    let read = format!("{events} events, {grips} grip records, {memories} persisted values");
    if found > 0 {
        out.flush()?;
        bail!("{read}; findings: {found}");
    }
    Ok(writeln!(out, "{read}: all intact")?)
}
