//! Retention: the oldest records are removed in small steps between batches, and an event attests each removal.
//!
//! A removal begins with its `pruned` event. The newest `pruned` event names the last removed record of each chain and
//! its hash, which proves that the remaining records are all that followed.

use std::time::{Duration, Instant};

use jiff::{SignedDuration, Timestamp};
use rusqlite::{Connection, OptionalExtension, params};

use super::Retention;
use super::chain::{Chain, Tip};
use super::kept_events;
use super::row::{Row, milliseconds, now};
use super::schema::SPAN_BITS;
use super::store::{Store, anchor, insert, remove_spans};
use crate::model::{Detail, Event, GatewayEvent};

/// Records removed per step, or twice those written since the last step if that is more. A step takes some
/// milliseconds, during which a command may have to wait.
const STEP: i64 = 256;

/// Maximum number of pages that a step gives back to the disk: more than the step's records take.
const STEP_PAGES: i64 = 1024;

/// Interval between checks for records beyond the limits.
const EVERY: Duration = Duration::from_mins(1);

/// Part of the size limit, as a divisor. Once this part has been written since the last check, the next check is due
/// early.
const LOOK_PART: u64 = 64;

/// Age beyond the limit at which a removal begins. Without this leeway every check would remove a few records and add
/// an event.
const LEEWAY: SignedDuration = SignedDuration::from_hours(1);

/// Size in percent of the limit to which a removal shrinks the journal, so that the next removal is not due at once.
const SHRINK_TO_PERCENT: u64 = 90;

/// State of the removal of old records.
#[derive(Debug)]
pub(super) struct Pruning {
    retention: Retention,
    due: Instant,
    /// Whether a journal that was too large is being shrunk.
    shrinking: bool,
    /// Whether the wall clock is doubtful, so that no record is removed for its age.
    pub(super) is_clock_doubtful: bool,
    /// Removal in progress.
    removal: Option<Removal>,
    /// Records written since the last step, and bytes since the last check.
    rows: i64,
    bytes: u64,
}

/// A removal of old records.
#[derive(Debug)]
struct Removal {
    /// Last event and last grip record to remove.
    last: [Tip; 2],
    /// Limit of the events that stay.
    kept: kept_events::KeptLimit,
}

impl Pruning {
    pub(super) fn new(retention: Retention, now: Instant) -> Self {
        Self { retention, due: now, shrinking: false, is_clock_doubtful: false, removal: None, rows: 0, bytes: 0 }
    }

    /// Whether the next step begins with a look at all records, and not within a removal.
    pub(super) fn is_looking(&self) -> bool {
        self.removal.is_none()
    }

    /// Returns the time of the next step.
    pub(super) fn due(&self) -> Instant {
        self.due
    }

    /// Counts written records.
    pub(super) fn wrote(&mut self, rows: &[Row], at: Instant) {
        self.rows += i64::try_from(rows.len()).unwrap_or(i64::MAX);
        self.bytes += rows.iter().map(Row::bytes).sum::<u64>();
        if self.retention.max_bytes.is_some_and(|max| self.bytes > max / LOOK_PART) {
            self.due = self.due.min(at);
        }
    }

    /// Removes some records of the current removal, and returns the event that attests what stays once it has ended. If
    /// none is in progress, checks for records beyond the limits, and returns the event that attests their removal.
    pub(super) fn step(&mut self, store: &mut Store, end: Tip, at: Instant) -> rusqlite::Result<Option<Row>> {
        self.step_at(store, end, at, now())
    }

    pub(super) fn step_at(
        &mut self,
        store: &mut Store,
        end: Tip,
        at: Instant,
        wall: Timestamp,
    ) -> rusqlite::Result<Option<Row>> {
        self.due = at + EVERY;
        let step = STEP.max(std::mem::take(&mut self.rows).saturating_mul(2));
        if let Some(removal) = self.removal.take() {
            self.due = at;
            if remove(store, &removal, step)? {
                self.removal = Some(removal);
                return Ok(None);
            }
            let attestation = kept_events::attestation(&store.connection)?;
            return attestation.map(|event| attest(store, event, end)).transpose();
        }
        self.bytes = 0;
        let Some(removal) = self.look(&store.connection, wall)? else { return Ok(None) };
        let row = attest(store, pruned(&removal), end)?;
        self.removal = Some(removal);
        self.due = at;
        Ok(Some(row))
    }

    /// Returns the event that attests what stays, if a removal is in progress.
    pub(super) fn interrupted(&self, connection: &Connection) -> rusqlite::Result<Option<GatewayEvent>> {
        if self.is_looking() { Ok(None) } else { kept_events::attestation(connection) }
    }

    fn look(&mut self, connection: &Connection, now: Timestamp) -> rusqlite::Result<Option<Removal>> {
        let max_age = self.retention.max_age.filter(|_| !self.is_clock_doubtful);
        if let Some(before) = max_age.and_then(|age| now.checked_sub(age).ok()) {
            for chain in Chain::ALL {
                if oldest(connection, chain, now)?.is_some_and(|at| is_overdue(at, before))
                    && let Some(last) = removal(connection, |chain| before_time(connection, chain, before, now))?
                {
                    return Ok(Some(Removal { last, kept: kept_events::KeptLimit::Age(milliseconds(before)) }));
                }
            }
            // Events that a removal for the size has left get too old as well.
            if kept_events::oldest(connection)?.is_some_and(|at| is_overdue(at, before)) {
                let last = [anchor(connection, Chain::Events)?, anchor(connection, Chain::Grips)?];
                return Ok(Some(Removal { last, kept: kept_events::KeptLimit::Age(milliseconds(before)) }));
            }
        }
        let Some(max) = self.retention.max_bytes else { return Ok(None) };
        let target = if self.shrinking { max / 100 * SHRINK_TO_PERCENT } else { max };
        let used = used(connection)?;
        self.shrinking = used > target;
        if !self.shrinking {
            return Ok(None);
        }
        let excess = (used - max / 100 * SHRINK_TO_PERCENT) as f64 / used as f64;
        let last = removal(connection, |chain| {
            let anchor = anchor(connection, chain)?.seq;
            let newest = newest(connection, chain)?;
            Ok(anchor + (((newest - anchor) as f64 * excess) as i64).max(STEP))
        })?;
        Ok(last.map(|last| Removal { last, kept: kept_events::KeptLimit::Size(max) }))
    }
}

/// Whether a record of the time `at`, in ms since 1970, is older than `before` by more than the leeway.
fn is_overdue(at: i64, before: Timestamp) -> bool {
    at < milliseconds(before - LEEWAY)
}

/// Returns the last record that can be removed of each chain, where `last` is the last that should be. Records of a
/// running command and the end of a chain stay.
fn removal(
    connection: &Connection,
    last: impl Fn(Chain) -> rusqlite::Result<i64>,
) -> rusqlite::Result<Option<[Tip; 2]>> {
    let mut removal = [anchor(connection, Chain::Events)?, anchor(connection, Chain::Grips)?];
    let before = removal;
    for chain in Chain::ALL {
        let mut last = last(chain)?.min(newest(connection, chain)? - 1);
        if chain == Chain::Events {
            let running = "SELECT min(seq) FROM running";
            let running: Option<i64> = connection.query_row(running, [], |row| row.get(0))?;
            last = last.min(running.map_or(i64::MAX, |running| running - 1));
        }
        if last > before[chain as usize].seq {
            let sql = format!("SELECT hash FROM {} WHERE seq = ?", chain.name());
            let hash = connection.query_row(&sql, [last], |row| row.get(0))?;
            removal[chain as usize] = Tip { seq: last, hash };
        }
    }
    Ok((removal != before).then_some(removal))
}

fn newest(connection: &Connection, chain: Chain) -> rusqlite::Result<i64> {
    let sql = format!("SELECT coalesce(max(seq), 0) FROM {}", chain.name());
    connection.query_row(&sql, [], |row| row.get(0))
}

/// Returns the last record before the first that is new enough. Records from the future come from a wrong clock, and
/// are removed with their neighbours.
fn before_time(connection: &Connection, chain: Chain, before: Timestamp, now: Timestamp) -> rusqlite::Result<i64> {
    let first = first_within(connection, chain, milliseconds(before), now)?;
    Ok(first.map_or(i64::MAX, |(seq, _)| seq - 1))
}

/// Returns the time of the first record that is not from the future.
fn oldest(connection: &Connection, chain: Chain, now: Timestamp) -> rusqlite::Result<Option<i64>> {
    Ok(first_within(connection, chain, i64::MIN, now)?.map(|(_, at)| at))
}

/// Finds the first record with a time between `from` and `now`, without events that an earlier removal has left.
/// Returns its sequence number and its time.
fn first_within(
    connection: &Connection,
    chain: Chain,
    from: i64,
    now: Timestamp,
) -> rusqlite::Result<Option<(i64, i64)>> {
    let table = chain.name();
    let sql = format!(
        "SELECT seq, at FROM {table} NOT INDEXED WHERE at BETWEEN ?1 AND ?2 AND seq > ?4 AND seq >=
             (SELECT min(span) << {SPAN_BITS} FROM spans
              WHERE chain = ?3 AND newest >= ?1 AND oldest <= ?2 AND span >= ?4 >> {SPAN_BITS})
         ORDER BY seq LIMIT 1"
    );
    let values = params![from, milliseconds(now), table, anchor(connection, chain)?.seq];
    connection.query_row(&sql, values, |row| Ok((row.get(0)?, row.get(1)?))).optional()
}

/// Returns the file's size without its free pages, in bytes.
fn used(connection: &Connection) -> rusqlite::Result<u64> {
    let pages = pragma(connection, "page_count")? - pragma(connection, "freelist_count")?;
    Ok(pages * pragma(connection, "page_size")?)
}

fn pragma(connection: &Connection, name: &str) -> rusqlite::Result<u64> {
    connection.pragma_query_value(None, name, |row| row.get::<_, u32>(0).map(u64::from))
}

/// Returns the event that attests a removal. It is written before the removal begins.
fn pruned(removal: &Removal) -> GatewayEvent {
    let [events, grips] = removal.last;
    GatewayEvent::Pruned {
        up_to_seq: events.seq,
        hash: hex::encode(events.hash),
        grips_up_to_seq: grips.seq,
        grips_hash: hex::encode(grips.hash),
    }
}

fn attest(store: &mut Store, event: GatewayEvent, end: Tip) -> rusqlite::Result<Row> {
    let row = Row::event(end, &Event::new(now(), None, Detail::Gateway(event)))
        .map_err(|error| rusqlite::Error::ToSqlConversionFailure(error.into()))?;
    let transaction = store.begin()?;
    insert(&transaction, &row)?;
    transaction.commit()?;
    Ok(row)
}

/// Removes one step of a removal; returns false once all is removed.
fn remove(store: &mut Store, removal: &Removal, step: i64) -> rusqlite::Result<bool> {
    for chain in Chain::ALL {
        let before = anchor(&store.connection, chain)?.seq;
        let last = removal.last[chain as usize].seq;
        if before < last {
            remove_of(store, chain, last.min(before + step), removal.kept, step)?;
            // The removal counts even if the file does not shrink.
            if let Err(error) = give_back(&store.connection) {
                tracing::warn!(failure = store.source.describe(&error), "journal file not shrunk");
            }
            return Ok(true);
        }
    }
    // More of the events that earlier removals have left can be beyond the limit than the steps above have removed.
    let transaction = store.begin()?;
    let has_removed = kept_events::trim(&transaction, removal.kept, step)?;
    transaction.commit()?;
    Ok(has_removed)
}

/// Removes a chain's records up to `last`. Events with a share of the file stay.
fn remove_of(
    store: &mut Store,
    chain: Chain,
    last: i64,
    limit: kept_events::KeptLimit,
    step: i64,
) -> rusqlite::Result<()> {
    let transaction = store.begin()?;
    let table = chain.name();
    let hash: [u8; 32] =
        transaction.query_row(&format!("SELECT hash FROM {table} WHERE seq = ?"), [last], |row| row.get(0))?;
    let first = anchor(&transaction, chain)?.seq + 1;
    match chain {
        Chain::Events => {
            if matches!(limit, kept_events::KeptLimit::Size(_)) {
                kept_events::enter(&transaction, last)?;
            }
            let others = "DELETE FROM events WHERE seq BETWEEN ? AND ? AND NOT EXISTS
                 (SELECT 1 FROM kept WHERE share IN ('fast_stops', 'access') AND kept.seq = events.seq)";
            transaction.execute(others, [first, last])?;
        }
        Chain::Grips => {
            transaction.execute("DELETE FROM grips WHERE seq <= ?", [last])?;
        }
    }
    remove_spans(&transaction, chain, first, last)?;
    let sql = "INSERT OR REPLACE INTO anchors(chain, seq, hash) VALUES (?, ?, ?)";
    transaction.execute(sql, params![table, last, hash])?;
    if chain == Chain::Events {
        kept_events::trim(&transaction, limit, step)?;
    }
    transaction.commit()
}

/// Gives free pages back to the disk.
fn give_back(connection: &Connection) -> rusqlite::Result<()> {
    let mut statement = connection.prepare_cached(&format!("PRAGMA incremental_vacuum({STEP_PAGES})"))?;
    let mut rows = statement.query([])?;
    while rows.next()?.is_some() {}
    Ok(())
}
