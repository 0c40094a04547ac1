//! Verification of the events that removals have left.

use rusqlite::Connection;
use serde::Deserialize as _;
use serde_json::Value;

use super::super::chain::{Chain, Hash, Tip, hash};
use super::super::kept_events::{Share, beginning, kept_share, link};
use super::super::store::anchor;
use super::Verifier;
use super::walk::{PART, body_of, check_body};
use crate::model::KeptShare;

/// Ends of the shares as the newest event of a removal attests them.
#[derive(Debug, Default)]
pub(super) struct AttestedShares {
    /// Sequence number of the newest `pruned` event, and of the newest `kept` event; 0 without such an event.
    pruned_seq: i64,
    kept_seq: i64,
    shares: Vec<KeptShare>,
}

impl AttestedShares {
    pub(super) fn pruned(&mut self, seq: i64) {
        self.pruned_seq = seq;
    }

    pub(super) fn kept(&mut self, seq: i64, body: &Value) {
        self.kept_seq = seq;
        let shares = body["shares"].as_array().map(Vec::as_slice).unwrap_or_default();
        self.shares = shares.iter().filter_map(|share| KeptShare::deserialize(share).ok()).collect();
    }
}

/// A walk along the entries of a share, in parts.
#[derive(Debug)]
pub(super) struct KeptWalk {
    share: Share,
    /// The entry before.
    before: Tip,
}

/// An entry, and its event if that is there.
struct Entry {
    seq: i64,
    previous: Hash,
    link: Hash,
    event: Option<Event>,
}

/// The columns of an event.
struct Event {
    hash: Hash,
    at: i64,
    body: String,
}

impl Event {
    fn of(row: &rusqlite::Row<'_>) -> rusqlite::Result<Option<Self>> {
        let Some(hash) = row.get(3)? else { return Ok(None) };
        Ok(Some(Self { hash, at: row.get(4)?, body: row.get(5)? }))
    }
}

impl KeptWalk {
    /// Walks along all entries. A file of an earlier version has none.
    pub(super) fn all(connection: &Connection) -> rusqlite::Result<Vec<Self>> {
        if !connection.table_exists(None, "kept")? {
            return Ok(Vec::new());
        }
        let walks = Share::ALL.map(|share| Ok(Self { share, before: beginning(connection, share)? }));
        walks.into_iter().collect()
    }

    /// Reads the next part, as the share is at this moment. Returns false at its end.
    pub(super) fn part(&mut self, verifier: &mut Verifier, connection: &Connection) -> rusqlite::Result<bool> {
        let beginning = beginning(connection, self.share)?;
        if beginning.seq > self.before.seq {
            // Entries were removed since the last part.
            self.before = beginning;
        }
        let sql = "SELECT kept.seq, previous, link, hash, at, body FROM kept LEFT JOIN events ON events.seq = kept.seq
                   WHERE share = ? AND kept.seq > ? ORDER BY kept.seq LIMIT ?";
        let mut statement = connection.prepare_cached(sql)?;
        let mut rows = statement.query(rusqlite::params![self.share.name(), self.before.seq, PART])?;
        let mut count = 0;
        while let Some(row) = rows.next()? {
            count += 1;
            let event = Event::of(row)?;
            let entry = Entry { seq: row.get(0)?, previous: row.get(1)?, link: row.get(2)?, event };
            self.entry(verifier, &entry);
        }
        Ok(count == PART)
    }

    fn entry(&mut self, verifier: &mut Verifier, entry: &Entry) {
        let seq = entry.seq;
        let name = format!("events {seq}");
        let expected = match &entry.event {
            None => {
                verifier.find(&name, "missing, although it is listed among the kept events");
                None
            }
            Some(event) => {
                verifier.report.events += 1;
                if hash(&entry.previous, event.body.as_bytes(), &[]) != event.hash {
                    verifier.find(&name, "changed since it was written (hash mismatch)");
                }
                match body_of(event.body.as_bytes()) {
                    Some(body) => check_body(verifier, Chain::Events, seq, event.at, &body),
                    None => verifier.find(&name, "body is not valid JSON"),
                }
                Some(link(&self.before.hash, seq, &event.hash))
            }
        };
        if expected.is_some_and(|expected| expected != entry.link) {
            let detail = "changed since it was entered, or an entry before it was removed (link mismatch)";
            verifier.find(format!("kept {} {seq}", self.share.name()), detail);
        }
        self.before = Tip { seq, hash: entry.link };
    }

    /// Compares the ends of the share with the newest attestation.
    pub(super) fn finish(&self, verifier: &mut Verifier, connection: &Connection) -> rusqlite::Result<()> {
        let name = self.share.name();
        let beginning = beginning(connection, self.share)?;
        let attested = verifier.shares.shares.iter().find(|attested| attested.share == name).cloned();
        let is_removing = verifier.shares.pruned_seq > verifier.shares.kept_seq;
        let ends = kept_share(self.share, beginning, self.before);
        let is_attested = match attested {
            // Entries are being added and removed.
            _ if is_removing && self.has(connection, attested.as_ref(), beginning)? => true,
            Some(attested) => attested == ends,
            None => self.before == Tip::default(),
        };
        if !is_attested {
            verifier.find(format!("kept {name}"), "the ends of the share do not match the newest `kept` event");
        }
        Ok(())
    }

    /// Whether the share still has the entry that was its newest at the last attestation, or has removed it.
    fn has(&self, connection: &Connection, attested: Option<&KeptShare>, beginning: Tip) -> rusqlite::Result<bool> {
        let Some(KeptShare { up_to_seq: seq, hash, .. }) = attested else { return Ok(true) };
        let sql = "SELECT count(*) FROM kept WHERE share = ? AND seq = ? AND hex(link) = upper(?)";
        let found: i64 =
            connection.query_row(sql, rusqlite::params![self.share.name(), seq, hash], |row| row.get(0))?;
        Ok(found == 1 || beginning.seq >= *seq)
    }
}

impl Verifier {
    /// Finds events that a removal should have removed.
    pub(super) fn left_behind(&mut self, connection: &Connection) -> rusqlite::Result<()> {
        let kept = if connection.table_exists(None, "kept")? {
            "AND NOT EXISTS (SELECT 1 FROM kept WHERE share IN ('fast_stops', 'access') AND kept.seq = events.seq)"
        } else {
            ""
        };
        let sql = format!("SELECT seq FROM events NOT INDEXED WHERE seq <= ? {kept} ORDER BY seq LIMIT 1000");
        let mut statement = connection.prepare(&sql)?;
        let mut rows = statement.query([anchor(connection, Chain::Events)?.seq])?;
        while let Some(row) = rows.next()? {
            let seq: i64 = row.get(0)?;
            self.find(format!("events {seq}"), "should have been removed with the events around it");
        }
        Ok(())
    }
}
