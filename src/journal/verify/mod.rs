//! Verification of a journal: reads and hashes each record, and compares it with the indexes by which it is found.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;
use std::time::{Duration, Instant};

use rusqlite::{Connection, OptionalExtension, Row};

use super::chain::{Chain, memory_hash};
use super::head::{self, Head};
use super::identity::NO_GRIPPER;
use super::kept_events::TABLE as KEPT;
use super::reading::reader::Reader;
use super::reading::statistics;
use super::schema::TABLES;
use super::source::ReadError;
use super::store::anchor;
use kept_events::{AttestedShares, KeptWalk};
use walk::Walk;

mod kept_events;
#[cfg(test)]
mod tests;
mod walk;

/// Maximum number of findings that are listed; further ones are only counted.
const MAX_FINDINGS: usize = 1000;

/// Result of a verification.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Report {
    /// Number of events read.
    pub events: u64,
    /// Number of grip records read.
    pub grips: u64,
    /// Number of persisted values read.
    pub memories: u64,
    /// The first thousand findings.
    pub findings: Vec<Finding>,
    /// Number of further findings.
    pub more: u64,
}

/// A difference from the journal as it was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// The record: `events 17`, `grips 3`, `memory left latch`, `anchors events`, `running …`, or `file`.
    pub record: String,
    pub detail: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.record, self.detail)
    }
}

/// Verifies a whole journal as it is at this moment, even while a gateway writes to it or after one was killed.
///
/// # Errors
/// [`ReadError`], if the file is missing, is not a journal, or has another version.
pub fn verify(path: &Path) -> Result<Report, ReadError> {
    verify_with_progress(path, None, |_, _| {})
}

/// Verifies like [`verify`], and compares the journal with an earlier head. Calls `progress` with the numbers of records
/// that were read and of all records.
///
/// # Errors
/// As [`verify`].
pub fn verify_with_progress(
    path: &Path,
    head: Option<Head>,
    mut progress: impl FnMut(u64, u64),
) -> Result<Report, ReadError> {
    let reader = Reader::open(path)?;
    reader.with(|connection| {
        // Read before the records, because a gateway may be writing new ones.
        let kept = head::kept(path, connection);
        let snapshot = connection.unchecked_transaction()?;
        let mut verifier = Verifier::default();
        verifier.tables(&snapshot);
        let records = "SELECT (SELECT count(*) FROM events) + (SELECT count(*) FROM grips)";
        // A damaged file may have no number of records.
        let all: i64 = snapshot.query_row(records, [], |row| row.get(0)).unwrap_or_default();
        verifier.records(&snapshot, &mut |read| progress(read, all.unsigned_abs()));
        for (head, is_newest) in kept.map(|head| (head, true)).into_iter().chain(head.map(|head| (head, false))) {
            verifier.check("head", |this| this.head(&snapshot, head, is_newest));
        }
        verifier.integrity(&snapshot);
        Ok(verifier.report)
    })
}

/// Verifies only the newest records: the quick check at the start, which takes milliseconds whatever the file's size.
pub(super) fn verify_newest(connection: &Connection, records: i64) -> Report {
    let mut verifier = Verifier::default();
    verifier.tables(connection);
    for chain in Chain::ALL {
        verifier.check(chain.name(), |this| {
            let mut walk = Walk::newest(connection, chain, records)?;
            while walk.part(this, connection)? {}
            Ok(())
        });
    }
    verifier.check("memory", |this| this.memory(connection));
    verifier.report
}

/// Verifies a whole journal in parts, while it is written. Calls `pause` after each part with the time that the part
/// took; if it returns false, the check ends without a report.
///
/// The check of the file's pages and indexes, at the end, is a single statement; an interrupt ends it early.
pub(super) fn verify_in_parts(reader: &Reader, mut pause: impl FnMut(Duration) -> bool) -> Option<Report> {
    let mut verifier = Verifier::default();
    let read = reader.with(|connection| {
        verifier.tables(connection);
        let mut walks = [Walk::all(connection, Chain::Events)?, Walk::all(connection, Chain::Grips)?];
        let mut kept = KeptWalk::all(connection)?;
        for walk in &mut walks {
            if !in_parts(connection, &mut pause, |snapshot| walk.part(&mut verifier, snapshot))? {
                return Ok(());
            }
        }
        for walk in &mut kept {
            if !in_parts(connection, &mut pause, |snapshot| walk.part(&mut verifier, snapshot))? {
                return Ok(());
            }
        }
        // New records, and the tables besides the chains, are read at the same moment.
        let snapshot = connection.unchecked_transaction()?;
        verifier.finish(&snapshot, walks, kept, &mut |_| {});
        drop(snapshot);
        verifier.integrity(connection);
        Ok(())
    });
    if let Err(error) = read {
        verifier.find("file", error);
    }
    pause(Duration::ZERO).then_some(verifier.report)
}

/// Reads part after part, each of another moment. Returns false if `pause` ends the check.
fn in_parts(
    connection: &Connection,
    pause: &mut impl FnMut(Duration) -> bool,
    mut part: impl FnMut(&Connection) -> rusqlite::Result<bool>,
) -> rusqlite::Result<bool> {
    loop {
        let began = Instant::now();
        let snapshot = connection.unchecked_transaction()?;
        let more = part(&snapshot)?;
        drop(snapshot);
        if !pause(began.elapsed()) {
            return Ok(false);
        }
        if !more {
            return Ok(true);
        }
    }
}

#[derive(Debug, Default)]
struct Verifier {
    report: Report,
    /// Commands that were admitted and have not ended, according to the events.
    running: BTreeMap<String, i64>,
    /// Last removed record of each chain, according to the newest `pruned` event.
    attested: BTreeMap<Chain, (i64, String)>,
    /// Ends of the shares of kept events, according to the newest events.
    shares: AttestedShares,
    /// Newest event with a head, and the grip record that it names with its hash.
    named_grip: (i64, i64, String),
}

impl Verifier {
    fn find(&mut self, record: impl fmt::Display, detail: impl fmt::Display) {
        if self.report.findings.len() < MAX_FINDINGS {
            self.report.findings.push(Finding { record: record.to_string(), detail: detail.to_string() });
        } else {
            self.report.more += 1;
        }
    }

    /// Runs a check, and reports a read error as a finding.
    fn check(&mut self, record: &str, check: impl FnOnce(&mut Self) -> rusqlite::Result<()>) {
        if let Err(error) = check(self) {
            self.find(record, format!("cannot be read: {error}"));
        }
    }

    /// Checks the definitions of tables and indexes: an index of other columns would find other records.
    fn tables(&mut self, connection: &Connection) {
        self.check("file", |this| {
            let found = tables(connection)?;
            let expected = Connection::open_in_memory()?;
            expected.execute_batch(TABLES)?;
            let oldest = tables(&expected)?;
            expected.execute_batch(statistics::INDEX)?;
            expected.execute_batch(KEPT)?;
            // A file that no newer gateway has opened for writing lacks some.
            if !found.is_superset(&oldest) || !found.is_subset(&tables(&expected)?) {
                this.find("file", "tables or indexes differ from those of a journal");
            }
            Ok(())
        });
    }

    fn records(&mut self, connection: &Connection, progress: &mut dyn FnMut(u64)) {
        let walks = Chain::ALL.map(|chain| Walk::all(connection, chain).map_err(|error| (chain, error)));
        let mut begun = Vec::new();
        for walk in walks {
            match walk {
                Ok(walk) => begun.push(walk),
                Err((chain, error)) => self.find(chain.name(), format!("cannot be read: {error}")),
            }
        }
        let kept = KeptWalk::all(connection).unwrap_or_else(|error| {
            self.find("kept", format!("cannot be read: {error}"));
            Vec::new()
        });
        self.finish(connection, begun, kept, progress);
    }

    /// Walks to the ends of the chains, and compares the other tables with them. Calls `progress` with the number of
    /// records that were read.
    fn finish(
        &mut self,
        connection: &Connection,
        walks: impl IntoIterator<Item = Walk>,
        kept: Vec<KeptWalk>,
        progress: &mut dyn FnMut(u64),
    ) {
        for mut walk in walks {
            self.check(walk.chain().name(), |this| {
                while walk.part(this, connection)? {
                    progress(this.report.events + this.report.grips);
                }
                Ok(())
            });
        }
        for mut walk in kept {
            self.check("kept", |this| {
                while walk.part(this, connection)? {}
                walk.finish(this, connection)
            });
        }
        self.check("events", |this| this.left_behind(connection));
        self.check("anchors", |this| this.anchors(connection));
        self.check("grips", |this| this.named_grip(connection));
        self.check("running", |this| this.running(connection));
        self.check("memory", |this| this.memory(connection));
    }

    fn anchors(&mut self, connection: &Connection) -> rusqlite::Result<()> {
        for chain in Chain::ALL {
            let anchor = anchor(connection, chain)?;
            let attested = match self.attested.get(&chain) {
                Some((seq, hash)) if *seq == anchor.seq => *hash == hex::encode(anchor.hash),
                // The attested records are still being removed.
                Some((seq, hash)) => anchor.seq < *seq && *hash == hash_of(connection, chain, *seq)?,
                None => anchor.seq == 0,
            };
            if !attested {
                let detail = format!("last removed record {} does not match the newest `pruned` event", anchor.seq);
                self.find(format!("anchors {}", chain.name()), detail);
            }
        }
        Ok(())
    }

    /// Checks that the grip record is there that the newest head names. Later ones may be newer than the head.
    fn named_grip(&mut self, connection: &Connection) -> rusqlite::Result<()> {
        let (event, seq, hash) = std::mem::take(&mut self.named_grip);
        if seq > anchor(connection, Chain::Grips)?.seq && hash_of(connection, Chain::Grips, seq)? != hash {
            self.find(format!("grips {seq}"), format!("missing or changed, although event {event} names it"));
        }
        Ok(())
    }

    fn running(&mut self, connection: &Connection) -> rusqlite::Result<()> {
        let mut statement = connection.prepare("SELECT command_id, seq FROM running")?;
        let stored = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
        let stored: BTreeSet<(String, i64)> = stored.collect::<Result<_, _>>()?;
        let expected: BTreeSet<_> = std::mem::take(&mut self.running).into_iter().collect();
        for (id, seq) in stored.symmetric_difference(&expected) {
            self.find(format!("running {id}"), format!("running commands do not match the events (event {seq})"));
        }
        Ok(())
    }

    fn memory(&mut self, connection: &Connection) -> rusqlite::Result<()> {
        let mut statement = connection.prepare("SELECT gripper, key, value, hash FROM memory")?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let gripper = text(row, 0)?;
            let key = text(row, 1)?;
            let value = text(row, 2)?;
            self.report.memories += u64::from(gripper != NO_GRIPPER);
            if !row.get_ref(3)?.as_blob().is_ok_and(|hash| hash == memory_hash(&gripper, &key, &value)) {
                self.find(format!("memory {gripper} {key}"), "changed since it was written (hash mismatch)");
            }
        }
        Ok(())
    }

    /// Compares the ends of the chains with an earlier head.
    fn head(&mut self, connection: &Connection, head: Head, is_newest: bool) -> rusqlite::Result<()> {
        for difference in head.differences(connection, is_newest)? {
            self.find("head", difference);
        }
        Ok(())
    }

    /// Checks the file's pages, and that each index has each record.
    fn integrity(&mut self, connection: &Connection) {
        self.check("file", |this| {
            let mut statement = connection.prepare("PRAGMA integrity_check")?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                let finding: String = row.get(0)?;
                if finding != "ok" {
                    this.find("file", finding);
                }
            }
            Ok(())
        });
    }
}

/// Returns a column's text; empty if the column is a number or null.
fn text<'a>(row: &'a Row<'_>, column: usize) -> rusqlite::Result<Cow<'a, str>> {
    Ok(row.get_ref(column)?.as_bytes().map(String::from_utf8_lossy).unwrap_or_default())
}

/// Returns a record's hash; empty if the record is missing.
fn hash_of(connection: &Connection, chain: Chain, seq: i64) -> rusqlite::Result<String> {
    let sql = format!("SELECT hash FROM {} WHERE seq = ?", chain.name());
    let hash: Option<Vec<u8>> = connection.query_row(&sql, [seq], |row| row.get(0)).optional()?;
    Ok(hash.map(hex::encode).unwrap_or_default())
}

/// Returns the definitions of tables and indexes, as SQL.
fn tables(connection: &Connection) -> rusqlite::Result<BTreeSet<[Option<String>; 4]>> {
    let mut statement = connection.prepare("SELECT type, name, tbl_name, sql FROM sqlite_schema")?;
    let rows = statement.query_map([], |row| Ok([row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?]))?;
    rows.collect()
}
