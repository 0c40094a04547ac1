//! A walk along a chain, from its oldest remaining record to its end, in parts of a bounded size.

use rusqlite::types::ValueRef;
use rusqlite::{Connection, OptionalExtension as _, Row, params};
use serde_json::Value;

use super::super::chain::{Chain, Hash, Tip, hash};
use super::super::curve;
use super::super::row::milliseconds;
use super::super::schema::SPAN_BITS;
use super::super::store::anchor;
use super::Verifier;

/// Records per part: some milliseconds of reading, during which the write-ahead log cannot be restarted.
pub(super) const PART: i64 = 1024;

/// A record as it is stored.
struct Raw<'a> {
    seq: i64,
    at: i64,
    body: &'a [u8],
    curve: &'a [u8],
    hash: Hash,
}

/// A position in a chain.
#[derive(Debug)]
pub(super) struct Walk {
    chain: Chain,
    /// Sequence number of the record before.
    seq: i64,
    /// Possible hashes of the record before: two if its body or its stored hash is damaged, none if it is missing.
    hashes: Vec<Hash>,
    /// Sequence number after which the next part begins.
    after: i64,
    /// Span that was read last, and its times.
    span: Option<(i64, Option<(i64, i64)>)>,
    /// Whether a record was unreadable, so that later ones are too.
    broken: bool,
}

impl Walk {
    /// Walks along all records of a chain.
    pub(super) fn all(connection: &Connection, chain: Chain) -> rusqlite::Result<Self> {
        let anchor = anchor(connection, chain)?;
        // Grip records before the anchor should have been removed, so they are findings. Events can have been kept.
        let after = if chain == Chain::Grips { i64::MIN } else { anchor.seq };
        Ok(Self { after, ..Self::after_tip(chain, anchor) })
    }

    /// Walks along the newest records of a chain.
    pub(super) fn newest(connection: &Connection, chain: Chain, records: i64) -> rusqlite::Result<Self> {
        let sql = format!("SELECT seq, hash FROM {} ORDER BY seq DESC LIMIT 1 OFFSET ?", chain.name());
        let tip = connection.query_row(&sql, [records], |row| Ok(Tip { seq: row.get(0)?, hash: row.get(1)? }));
        match tip.optional()? {
            Some(tip) => Ok(Self::after_tip(chain, tip)),
            None => Self::all(connection, chain),
        }
    }

    fn after_tip(chain: Chain, tip: Tip) -> Self {
        Self { chain, seq: tip.seq, hashes: vec![tip.hash], after: tip.seq, span: None, broken: false }
    }

    pub(super) fn chain(&self) -> Chain {
        self.chain
    }

    /// Reads the next part, as the chain is at this moment. Returns false at the end of the chain.
    pub(super) fn part(&mut self, verifier: &mut Verifier, connection: &Connection) -> rusqlite::Result<bool> {
        if self.broken {
            return Ok(false);
        }
        self.skip_removed(verifier, anchor(connection, self.chain)?);
        self.span = None;
        let sql = format!(
            "SELECT seq, at, body, curve, hash FROM {} NOT INDEXED WHERE seq > ? ORDER BY seq LIMIT ?",
            self.chain.name()
        );
        let mut statement = connection.prepare_cached(&sql)?;
        let mut rows = statement.query([self.after, PART])?;
        let mut count = 0;
        loop {
            match rows.next() {
                Ok(Some(row)) => self.row(verifier, connection, row)?,
                Ok(None) => return Ok(count == PART),
                Err(error) => {
                    self.broken = true;
                    self.find(verifier, self.seq + 1, format!("cannot be read, nor can later records: {error}"));
                    return Ok(false);
                }
            }
            count += 1;
        }
    }

    /// Skips records that were removed since the last part.
    fn skip_removed(&mut self, verifier: &mut Verifier, anchor: Tip) {
        if self.after != i64::MIN && anchor.seq > self.seq {
            if self.chain == Chain::Events {
                // Only commands that had ended were removed.
                verifier.running.retain(|_, seq| *seq > anchor.seq);
            }
            *self = Self::after_tip(self.chain, anchor);
        }
    }
}

/// Returns the earliest and the latest time of a span's records.
fn times(connection: &Connection, chain: Chain, span: i64) -> rusqlite::Result<Option<(i64, i64)>> {
    let sql = "SELECT oldest, newest FROM spans WHERE chain = ? AND span = ?";
    let mut statement = connection.prepare_cached(sql)?;
    statement.query_row(params![chain.name(), span], |row| Ok((row.get(0)?, row.get(1)?))).optional()
}

/// Parses a body.
pub(super) fn body_of(body: &[u8]) -> Option<Value> {
    serde_json::from_slice(body).ok()
}

fn raw<'a>(chain: Chain, row: &'a Row<'_>) -> rusqlite::Result<Option<Raw<'a>>> {
    let seq = row.get(0)?;
    let (ValueRef::Integer(at), ValueRef::Text(body)) = (row.get_ref(1)?, row.get_ref(2)?) else { return Ok(None) };
    let curve = match (chain, row.get_ref(3)?) {
        (Chain::Events, ValueRef::Null) => &[],
        (Chain::Grips, ValueRef::Blob(curve)) => curve,
        _ => return Ok(None),
    };
    let ValueRef::Blob(hash) = row.get_ref(4)? else { return Ok(None) };
    Ok(hash.try_into().ok().map(|hash| Raw { seq, at, body, curve, hash }))
}

impl Walk {
    fn find(&self, verifier: &mut Verifier, seq: i64, detail: impl std::fmt::Display) {
        verifier.find(format!("{} {seq}", self.chain.name()), detail);
    }

    fn row(&mut self, verifier: &mut Verifier, connection: &Connection, row: &Row<'_>) -> rusqlite::Result<()> {
        let count = match self.chain {
            Chain::Events => &mut verifier.report.events,
            Chain::Grips => &mut verifier.report.grips,
        };
        *count += 1;
        let seq: i64 = row.get(0)?;
        if seq != self.seq + 1 {
            self.find(verifier, self.seq + 1, format!("missing; the next record found is {seq}"));
            self.hashes.clear();
        }
        (self.seq, self.after) = (seq, seq);
        let Some(raw) = raw(self.chain, row)? else {
            self.find(verifier, seq, "columns have wrong types");
            self.hashes.clear();
            return Ok(());
        };
        let span = seq >> SPAN_BITS;
        if self.span.is_none_or(|(known, _)| known != span) {
            self.span = Some((span, times(connection, self.chain, span)?));
        }
        self.record(verifier, &raw);
        Ok(())
    }

    fn record(&mut self, verifier: &mut Verifier, raw: &Raw<'_>) {
        let computed: Vec<_> = self.hashes.iter().map(|previous| hash(previous, raw.body, raw.curve)).collect();
        self.hashes = vec![raw.hash];
        if !computed.is_empty() && !computed.contains(&raw.hash) {
            self.find(verifier, raw.seq, "changed since it was written (hash mismatch)");
            self.hashes.extend(computed);
        }
        if self.chain == Chain::Grips && curve::decode(raw.curve).is_err() {
            self.find(verifier, raw.seq, curve::NoCurve);
        }
        let times = self.span.and_then(|(_, times)| times);
        if !times.is_some_and(|(oldest, newest)| (oldest..=newest).contains(&raw.at)) {
            self.find(verifier, raw.seq, "time is outside the range in the time index");
        }
        match body_of(raw.body) {
            Some(body) => self.body(verifier, raw, &body),
            None => self.find(verifier, raw.seq, "body is not valid JSON"),
        }
    }

    fn body(&self, verifier: &mut Verifier, raw: &Raw<'_>, body: &Value) {
        check_body(verifier, self.chain, raw.seq, raw.at, body);
        if self.chain == Chain::Events {
            verifier.event(raw.seq, body);
        }
    }
}

/// Compares a body with its record's columns.
pub(super) fn check_body(verifier: &mut Verifier, chain: Chain, seq: i64, at: i64, body: &Value) {
    let name = format!("{} {seq}", chain.name());
    if body["seq"].as_i64() != Some(seq) {
        verifier.find(&name, format!("body has sequence number {}", body["seq"]));
    }
    let time = &body[chain.time_field()];
    if time.as_str().and_then(|at| at.parse().ok()).map(milliseconds) != Some(at) {
        verifier.find(&name, format!("body has time {time}, but the column has {at} ms"));
    }
}

impl Verifier {
    /// Notes the parts of an event that other tables repeat.
    fn event(&mut self, seq: i64, body: &Value) {
        match (body["kind"].as_str(), body["event"].as_str()) {
            (Some("command"), _) if body["outcome"].is_null() => {
                self.running.insert(text_in(body, "command_id"), seq);
            }
            (Some("command"), _) => {
                self.running.remove(&text_in(body, "command_id"));
            }
            (Some("gateway"), Some("pruned")) => {
                self.shares.pruned(seq);
                let events = (number_in(body, "up_to_seq"), text_in(body, "hash"));
                let grips = (number_in(body, "grips_up_to_seq"), text_in(body, "grips_hash"));
                self.attested.insert(Chain::Events, events);
                self.attested.insert(Chain::Grips, grips);
            }
            (Some("gateway"), Some("head")) => {
                self.named_grip = (seq, number_in(body, "grips_up_to_seq"), text_in(body, "grips_hash"));
            }
            (Some("gateway"), Some("kept")) => self.shares.kept(seq, body),
            _ => {}
        }
    }
}

fn text_in(body: &Value, field: &str) -> String {
    body[field].as_str().unwrap_or_default().to_owned()
}

fn number_in(body: &Value, field: &str) -> i64 {
    body[field].as_i64().unwrap_or_default()
}
