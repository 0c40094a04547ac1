//! Reading a journal's file: what happened, what happens, and whether it is as it was written.

use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::{Args, Subcommand, ValueEnum};
use serde::de::DeserializeOwned;

use crate::config::JournalFlags;
use crate::journal::csv::{EVENT_COLUMNS, GRIP_COLUMNS, header, lines};
use crate::journal::{
    Cursor, EventQuery, Filter, GripQuery, Limit, Order, Page, Query, ReadError, Reader, Report, verify,
};

mod line;

/// How often it is looked for what is new.
const POLL: Duration = Duration::from_millis(200);

/// How many records are listed where no number is said.
const LISTED: u64 = 100;

/// How many records are read at once.
const PAGE: u64 = 1000;

#[derive(Debug, Args)]
pub(super) struct Journal {
    #[command(flatten)]
    flags: JournalFlags,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Print records, one a line: the newest 100, if nothing else is said
    List {
        #[command(flatten)]
        which: Which,
    },
    /// Print each event as it becomes durable
    Follow {
        /// Begin behind the event with this number, rather than with the next one
        #[arg(long, value_name = "SEQ")]
        after: Option<u64>,
        #[command(flatten)]
        filters: Filters,
    },
    /// Write all fields of records, the oldest first
    Export {
        /// json: an object a line; csv: a header, and a line for each record
        #[arg(long, value_enum, default_value_t)]
        format: Format,
        #[command(flatten)]
        which: Which,
    },
    /// Check that each record is as it was written; exits with 1 where one isn't
    Verify,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Format {
    #[default]
    Json,
    Csv,
}

#[derive(Debug, Args)]
struct Which {
    /// Grip records instead of events
    #[arg(long)]
    grips: bool,
    #[command(flatten)]
    filters: Filters,
    /// How many at most
    #[arg(long, value_name = "N")]
    limit: Option<u64>,
    /// newest or oldest first
    #[arg(long, value_name = "ORDER")]
    order: Option<String>,
}

#[derive(Debug, Args)]
struct Filters {
    /// Of this gripper
    #[arg(long, value_name = "NAME")]
    gripper: Option<String>,
    /// Of this kind: command, fast_stop, acknowledge, lease, link, device, settings, refused or gateway; of grip records
    /// home, move, grip or release
    #[arg(long)]
    kind: Option<String>,
    /// Of this part
    #[arg(long, value_name = "PART")]
    part_id: Option<String>,
    /// With this outcome, e.g. PART_HELD or NO_PART
    #[arg(long)]
    outcome: Option<String>,
    /// Of this command
    #[arg(long, value_name = "ID")]
    command_id: Option<String>,
    /// Not before this time, e.g. 2026-11-21T09:00:00Z
    #[arg(long, value_name = "TIME")]
    from: Option<String>,
    /// Before this time
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
            outcome: value("--outcome", outcome.as_ref())?,
            command_id: value("--command-id", self.command_id.as_ref())?,
        };
        let (from, to) = (value("--from", self.from.as_ref())?, value("--to", self.to.as_ref())?);
        Ok(Query { filter, from, to, ..Query::default() })
    }
}

/// A value by its name in JSON.
fn value<T: DeserializeOwned>(flag: &str, text: Option<&String>) -> anyhow::Result<Option<T>> {
    let parse = |text: &String| serde_json::from_value(text.clone().into()).with_context(|| format!("{flag} {text}"));
    text.map(parse).transpose()
}

pub(super) fn run(journal: &Journal, out: impl Write) -> anyhow::Result<()> {
    let path = journal.flags.path()?;
    let mut out = BufWriter::new(out);
    let result = match &journal.command {
        Command::List { which } => {
            let limit = which.limit.unwrap_or(LISTED);
            each_page(&Reader::open(&path)?, which, Order::Newest, limit, |bodies| list(&mut out, bodies))
        }
        Command::Follow { after, filters } => follow(&Reader::open(&path)?, *after, filters, &mut out),
        Command::Export { format, which } => export(&Reader::open(&path)?, *format, which, &mut out),
        Command::Verify => check(&path, &mut out),
    };
    match result.and_then(|()| Ok(out.flush()?)) {
        // Whoever reads standard output may have enough of it: that is no error.
        Err(error)
            if error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe) =>
        {
            Ok(())
        }
        result => result,
    }
}

fn list(out: &mut impl Write, bodies: &[Arc<str>]) -> io::Result<()> {
    bodies.iter().try_for_each(|body| writeln!(out, "{}", line::of(body)))
}

fn export(reader: &Reader, format: Format, which: &Which, out: &mut impl Write) -> anyhow::Result<()> {
    let limit = which.limit.unwrap_or(u64::MAX);
    let columns = if which.grips { GRIP_COLUMNS } else { EVENT_COLUMNS };
    if format == Format::Csv {
        out.write_all(header(columns).as_bytes())?;
    }
    each_page(reader, which, Order::Oldest, limit, |bodies| match format {
        Format::Json => bodies.iter().try_for_each(|body| writeln!(out, "{body}")),
        Format::Csv => out.write_all(lines(columns, bodies.iter().map(|body| &**body)).as_bytes()),
    })
}

/// Takes page after page to `write`, until there are no more records, or as many as are wanted.
fn each_page(
    reader: &Reader,
    which: &Which,
    order: Order,
    limit: u64,
    write: impl FnMut(&[Arc<str>]) -> io::Result<()>,
) -> anyhow::Result<()> {
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
) -> anyhow::Result<()> {
    while limit > 0 {
        query.limit = Limit::new(limit.min(PAGE))?;
        let page = read(&query)?;
        write(&page.bodies)?;
        limit -= page.bodies.len() as u64;
        match page.next_cursor {
            Some(cursor) => query.cursor = Some(cursor.parse()?),
            None => break,
        }
    }
    Ok(())
}

fn follow(reader: &Reader, after: Option<u64>, filters: &Filters, out: &mut impl Write) -> anyhow::Result<()> {
    let mut query = EventQuery { order: Order::Oldest, ..filters.query()? };
    let mut after = match after {
        Some(after) => i64::try_from(after)?,
        None => reader.last_seq()?,
    };
    loop {
        // What comes while the page is read is looked for the next time.
        let last = reader.last_seq()?;
        query.cursor = Some(Cursor::behind(after));
        pages(query.clone(), u64::MAX, |query| reader.events_until(query, last), |bodies| list(out, bodies))?;
        out.flush()?;
        after = after.max(last);
        std::thread::sleep(POLL);
    }
}

fn check(path: &Path, out: &mut impl Write) -> anyhow::Result<()> {
    let report = verify(path)?;
    report.findings.iter().try_for_each(|finding| writeln!(out, "{finding}"))?;
    let found = report.findings.len() as u64 + report.more;
    let Report { events, grips, memories, .. } = report;
    let read = format!("{events} events, {grips} grip records, {memories} remembered values");
    if found > 0 {
        out.flush()?;
        bail!("{read}: {found} findings");
    }
    Ok(writeln!(out, "{read}: all as written")?)
}
