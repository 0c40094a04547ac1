//! Whether a journal is as it was written. Each record is read and hashed, and what it is found by is compared with it.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;
use std::time::{Duration, Instant};

use rusqlite::{Connection, OptionalExtension};

use super::chain::{Chain, memory_hash};
use super::reader::Reader;
use super::schema::TABLES;
use super::source::ReadError;
use super::store::anchor;
use walk::Walk;

#[cfg(test)]
mod tests;
mod walk;

/// How many findings are named; the rest is counted. A file that is damaged all over needs no more.
const MAX_FINDINGS: usize = 1000;

/// What was read, and what was found.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Report {
    /// How many events there are.
    pub events: u64,
    /// How many grip records.
    pub grips: u64,
    /// How many remembered values.
    pub memories: u64,
    /// What is not as it was written; the first thousand.
    pub findings: Vec<Finding>,
    /// How many more there are.
    pub more: u64,
}

/// Something that is not as it was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// The record: `events 17`, `grips 3`, `memory left latch`, `anchors events`, `running …`, or `file`.
    pub record: String,
    /// What is wrong with it.
    pub detail: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.record, self.detail)
    }
}

/// Reads a whole journal as it is at this moment. A gateway may be writing it, or may have been killed.
///
/// # Errors
/// [`ReadError`], where there is no such file, or it is not a journal of this version.
pub fn verify(path: &Path) -> Result<Report, ReadError> {
    let reader = Reader::open(path)?;
    reader.with(|connection| {
        let snapshot = connection.unchecked_transaction()?;
        let mut verifier = Verifier::default();
        verifier.tables(&snapshot);
        verifier.records(&snapshot);
        verifier.integrity(&snapshot);
        Ok(verifier.report)
    })
}

/// Reads the newest records alone: the quick check at the start, of a few milliseconds whatever the file's size.
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

/// Reads a whole journal in parts, while it is written. `pause` is called after each part with the time that it took;
/// where it says no, the check ends without a report.
///
/// The last statement, the check of the file's pages and indexes, is one: interrupting it ends it early.
pub(super) fn verify_in_parts(reader: &Reader, mut pause: impl FnMut(Duration) -> bool) -> Option<Report> {
    let mut verifier = Verifier::default();
    let read = reader.with(|connection| {
        verifier.tables(connection);
        let mut walks = [Walk::all(connection, Chain::Events)?, Walk::all(connection, Chain::Grips)?];
        for walk in &mut walks {
            loop {
                let began = Instant::now();
                let snapshot = connection.unchecked_transaction()?;
                let more = walk.part(&mut verifier, &snapshot)?;
                drop(snapshot);
                if !pause(began.elapsed()) {
                    return Ok(());
                }
                if !more {
                    break;
                }
            }
        }
        // What came meanwhile, and what the file keeps beside the chains, are of one moment.
        let snapshot = connection.unchecked_transaction()?;
        verifier.finish(&snapshot, walks);
        drop(snapshot);
        verifier.integrity(connection);
        Ok(())
    });
    if let Err(error) = read {
        verifier.find("file", error);
    }
    pause(Duration::ZERO).then_some(verifier.report)
}

#[derive(Debug, Default)]
struct Verifier {
    report: Report,
    /// The commands that were admitted and have not ended, by the records.
    running: BTreeMap<String, i64>,
    /// What the newest `pruned` event says of each chain's last removed record.
    attested: BTreeMap<Chain, (i64, String)>,
}

impl Verifier {
    fn find(&mut self, record: impl fmt::Display, detail: impl fmt::Display) {
        if self.report.findings.len() < MAX_FINDINGS {
            self.report.findings.push(Finding { record: record.to_string(), detail: detail.to_string() });
        } else {
            self.report.more += 1;
        }
    }

    /// What can't be read is a finding too.
    fn check(&mut self, record: &str, check: impl FnOnce(&mut Self) -> rusqlite::Result<()>) {
        if let Err(error) = check(self) {
            self.find(record, format!("can't be read: {error}"));
        }
    }

    /// Indexes of other columns would find other records.
    fn tables(&mut self, connection: &Connection) {
        self.check("file", |this| {
            let expected = Connection::open_in_memory()?;
            expected.execute_batch(TABLES)?;
            if tables(&expected)? != tables(connection)? {
                this.find("file", "its tables or indexes are not those of a journal");
            }
            Ok(())
        });
    }

    fn records(&mut self, connection: &Connection) {
        let walks = Chain::ALL.map(|chain| Walk::all(connection, chain).map_err(|error| (chain, error)));
        let mut begun = Vec::new();
        for walk in walks {
            match walk {
                Ok(walk) => begun.push(walk),
                Err((chain, error)) => self.find(chain.name(), format!("can't be read: {error}")),
            }
        }
        self.finish(connection, begun);
    }

    /// Goes to the ends of the chains, and compares what the file keeps beside them.
    fn finish(&mut self, connection: &Connection, walks: impl IntoIterator<Item = Walk>) {
        for mut walk in walks {
            self.check(walk.chain().name(), |this| {
                while walk.part(this, connection)? {}
                Ok(())
            });
        }
        self.check("anchors", |this| this.anchors(connection));
        self.check("running", |this| this.running(connection));
        self.check("memory", |this| this.memory(connection));
    }

    fn anchors(&mut self, connection: &Connection) -> rusqlite::Result<()> {
        for chain in Chain::ALL {
            let anchor = anchor(connection, chain)?;
            let attested = match self.attested.get(&chain) {
                Some((seq, hash)) if *seq == anchor.seq => *hash == hex::encode(anchor.hash),
                // What is attested is still being removed.
                Some((seq, hash)) => anchor.seq < *seq && *hash == hash_of(connection, chain, *seq)?,
                None => anchor.seq == 0,
            };
            if !attested {
                let detail = format!("that {} is the last removed record is not what the events attest", anchor.seq);
                self.find(format!("anchors {}", chain.name()), detail);
            }
        }
        Ok(())
    }

    fn running(&mut self, connection: &Connection) -> rusqlite::Result<()> {
        let mut statement = connection.prepare("SELECT command_id, seq FROM running")?;
        let stored = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
        let stored: BTreeSet<(String, i64)> = stored.collect::<Result<_, _>>()?;
        let expected: BTreeSet<_> = std::mem::take(&mut self.running).into_iter().collect();
        for (id, seq) in stored.symmetric_difference(&expected) {
            self.find(format!("running {id}"), format!("whether it has ended is not what the events say ({seq})"));
        }
        Ok(())
    }

    fn memory(&mut self, connection: &Connection) -> rusqlite::Result<()> {
        let mut statement = connection.prepare("SELECT gripper, key, value, hash FROM memory")?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            self.report.memories += 1;
            let text = |i| row.get_ref(i).map(|text| text.as_bytes().map(String::from_utf8_lossy).unwrap_or_default());
            let (gripper, key, value) = (text(0)?, text(1)?, text(2)?);
            if !row.get_ref(3)?.as_blob().is_ok_and(|hash| hash == memory_hash(&gripper, &key, &value)) {
                self.find(format!("memory {gripper} {key}"), "it is not as it was written (its hash is another)");
            }
        }
        Ok(())
    }

    /// What the file itself says: its pages, and that each index has each record.
    fn integrity(&mut self, connection: &Connection) {
        self.check("file", |this| {
            let mut statement = connection.prepare("PRAGMA integrity_check")?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                let said: String = row.get(0)?;
                if said != "ok" {
                    this.find("file", said);
                }
            }
            Ok(())
        });
    }
}

/// A record's hash; nothing where there is no such record.
fn hash_of(connection: &Connection, chain: Chain, seq: i64) -> rusqlite::Result<String> {
    let sql = format!("SELECT hash FROM {} WHERE seq = ?", chain.name());
    let hash: Option<Vec<u8>> = connection.query_row(&sql, [seq], |row| row.get(0)).optional()?;
    Ok(hash.map(hex::encode).unwrap_or_default())
}

/// What the tables and indexes are, as SQL.
fn tables(connection: &Connection) -> rusqlite::Result<BTreeSet<[Option<String>; 4]>> {
    let mut statement = connection.prepare("SELECT type, name, tbl_name, sql FROM sqlite_schema")?;
    let rows = statement.query_map([], |row| Ok([row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?]))?;
    rows.collect()
}
