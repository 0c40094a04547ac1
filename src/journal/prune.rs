//! Retention: the oldest records are removed in small steps between batches, and what is removed is attested.
//!
//! The newest `pruned` event names the last removed record of each chain and its hash, so that what is left is proved
//! to be all that followed.

use std::time::{Duration, Instant};

use jiff::{SignedDuration, Timestamp};
use rusqlite::{Connection, OptionalExtension, params};

use super::Retention;
use super::chain::{Chain, Tip};
use super::row::{Row, milliseconds, now};
use super::schema::SPAN_BITS;
use super::store::{Store, anchor, insert};
use crate::gripper::model::{Detail, Event, GatewayEvent};

/// How many records a step removes at most: some milliseconds, for which a command may have to wait.
const STEP: i64 = 256;

/// How many pages a step gives back to the disk at most; more than a step's records have.
const STEP_PAGES: i64 = 1024;

/// How often it is looked whether something is too old or too much.
const EVERY: Duration = Duration::from_mins(1);

/// How much older than allowed the oldest record gets, so that not each look removes a few, with an event of its own.
const LEEWAY: SignedDuration = SignedDuration::from_hours(1);

/// How much is left of a journal that was too large, in percent, so that it isn't soon again.
const SHRINK_TO_PERCENT: u64 = 90;

/// When and what to remove.
#[derive(Debug)]
pub(super) struct Pruning {
    retention: Retention,
    due: Instant,
    /// While a journal that was too large is made smaller.
    shrinking: bool,
}

/// The records of a chain up to this one can go.
struct Removal {
    chain: Chain,
    last: i64,
}

impl Pruning {
    pub(super) fn new(retention: Retention, now: Instant) -> Self {
        Self { retention, due: now, shrinking: false }
    }

    /// When the next step is.
    pub(super) fn due(&self) -> Instant {
        self.due
    }

    /// Removes some of what is too old or too much, and returns the event that attests it; none where nothing is.
    pub(super) fn step(&mut self, store: &mut Store, end: Tip, at: Instant) -> rusqlite::Result<Option<Row>> {
        self.due = at + EVERY;
        let Some(removal) = self.removal(&store.connection, now())? else { return Ok(None) };
        let row = remove(store, &removal, end)?;
        // What was removed is, whether or not the file gets smaller by it.
        if let Err(error) = give_back(&store.connection) {
            tracing::warn!(failure = store.source.words(&error), "the journal's file was not made smaller");
        }
        self.due = at;
        Ok(Some(row))
    }

    fn removal(&mut self, connection: &Connection, now: Timestamp) -> rusqlite::Result<Option<Removal>> {
        if let Some(before) = self.retention.max_age.and_then(|age| now.checked_sub(age).ok()) {
            for chain in Chain::ALL {
                let overdue = oldest(connection, chain)?.is_some_and(|at| at < milliseconds(before - LEEWAY));
                if overdue && let Some(removal) = last_of_step(connection, chain, milliseconds(before))? {
                    return Ok(Some(removal));
                }
            }
        }
        let Some(max) = self.retention.max_bytes else { return Ok(None) };
        let target = if self.shrinking { max / 100 * SHRINK_TO_PERCENT } else { max };
        self.shrinking = used(connection)? > target;
        if !self.shrinking {
            return Ok(None);
        }
        let mut removals = Vec::new();
        for chain in Chain::ALL {
            let removal = last_of_step(connection, chain, i64::MAX)?;
            removals.extend(removal.zip(oldest(connection, chain)?));
        }
        Ok(removals.into_iter().min_by_key(|(_, oldest)| *oldest).map(|(removal, _)| removal))
    }
}

/// The last of the chain's first records that a step removes: all before that time, none of a command that has not
/// ended, and never the chain's end.
fn last_of_step(connection: &Connection, chain: Chain, before: i64) -> rusqlite::Result<Option<Removal>> {
    let anchor = anchor(connection, chain)?.seq;
    let kept = match chain {
        Chain::Events => "coalesce((SELECT min(seq) FROM running), ?4)",
        Chain::Grips => "?4",
    };
    let table = chain.name();
    // The first that stays ends the removal, for a later one with an earlier time was written by a clock gone wrong.
    let sql = format!(
        "SELECT min(
             coalesce((SELECT min(seq) FROM {table} WHERE seq <= ?1 + ?2 AND at >= ?3), ?4) - 1,
             (SELECT max(seq) FROM {table}) - 1, ?1 + ?2, {kept} - 1)"
    );
    let values = params![anchor, STEP, before, i64::MAX];
    let last = connection.query_row(&sql, values, |row| row.get::<_, Option<i64>>(0))?.unwrap_or(anchor);
    Ok((last > anchor).then_some(Removal { chain, last }))
}

fn oldest(connection: &Connection, chain: Chain) -> rusqlite::Result<Option<i64>> {
    let sql = format!("SELECT at FROM {} ORDER BY seq LIMIT 1", chain.name());
    connection.query_row(&sql, [], |row| row.get(0)).optional()
}

/// How large the file is without its free pages, in bytes.
fn used(connection: &Connection) -> rusqlite::Result<u64> {
    let number = |pragma| connection.pragma_query_value(None, pragma, |row| row.get::<_, u32>(0).map(u64::from));
    Ok((number("page_count")? - number("freelist_count")?) * number("page_size")?)
}

fn remove(store: &mut Store, removal: &Removal, end: Tip) -> rusqlite::Result<Row> {
    let transaction = store.begin()?;
    let chain = removal.chain.name();
    let sql = format!("SELECT hash FROM {chain} WHERE seq = ?");
    let hash: [u8; 32] = transaction.query_row(&sql, [removal.last], |row| row.get(0))?;
    transaction.execute(&format!("DELETE FROM {chain} WHERE seq <= ?"), [removal.last])?;
    let spans = "DELETE FROM spans WHERE chain = ? AND span < ?";
    transaction.execute(spans, params![chain, (removal.last + 1) >> SPAN_BITS])?;
    let sql = "INSERT OR REPLACE INTO anchors(chain, seq, hash) VALUES (?, ?, ?)";
    transaction.execute(sql, params![chain, removal.last, hash])?;
    let (events, grips) = (anchor(&transaction, Chain::Events)?, anchor(&transaction, Chain::Grips)?);
    let event = GatewayEvent::Pruned {
        up_to_seq: events.seq,
        hash: hex::encode(events.hash),
        grips_up_to_seq: grips.seq,
        grips_hash: hex::encode(grips.hash),
    };
    let row = Row::event(end, &Event::new(now(), None, Detail::Gateway(event)))
        .map_err(|error| rusqlite::Error::ToSqlConversionFailure(error.into()))?;
    insert(&transaction, &row)?;
    transaction.commit()?;
    Ok(row)
}

/// Makes the file smaller.
fn give_back(connection: &Connection) -> rusqlite::Result<()> {
    let mut statement = connection.prepare_cached(&format!("PRAGMA incremental_vacuum({STEP_PAGES})"))?;
    let mut rows = statement.query([])?;
    while rows.next()?.is_some() {}
    Ok(())
}
