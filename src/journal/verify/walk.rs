//! A walk along a chain, from what is left of its beginning to its end.

use std::collections::BTreeMap;

use rusqlite::types::ValueRef;
use rusqlite::{Connection, Row};
use serde_json::Value;

use super::super::chain::{Chain, Hash, hash};
use super::super::curve;
use super::super::row::milliseconds;
use super::super::schema::SPAN_BITS;
use super::super::store::anchor;
use super::Verifier;

/// A record as it is stored.
struct Raw<'a> {
    seq: i64,
    at: i64,
    body: &'a [u8],
    curve: &'a [u8],
    hash: Hash,
}

struct Walk<'a> {
    verifier: &'a mut Verifier,
    chain: Chain,
    /// The record before.
    seq: i64,
    /// What its hash may be: two where it is not known which of its body and its hash is damaged; none where it is not
    /// there.
    hashes: Vec<Hash>,
    /// Times by span.
    spans: BTreeMap<i64, (i64, i64)>,
}

/// Reads all records of a chain.
pub(super) fn walk(verifier: &mut Verifier, connection: &Connection, chain: Chain) -> rusqlite::Result<()> {
    let anchor = anchor(connection, chain)?;
    let spans = spans(connection, chain)?;
    let mut walk = Walk { verifier, chain, seq: anchor.seq, hashes: vec![anchor.hash], spans };
    let sql = format!("SELECT seq, at, body, curve, hash FROM {} NOT INDEXED ORDER BY seq", chain.name());
    let mut statement = connection.prepare(&sql)?;
    let mut rows = statement.query([])?;
    loop {
        match rows.next() {
            Ok(Some(row)) => walk.row(row)?,
            Ok(None) => return Ok(()),
            Err(error) => {
                walk.find(walk.seq + 1, format!("can't be read, nor what follows: {error}"));
                return Ok(());
            }
        }
    }
}

fn spans(connection: &Connection, chain: Chain) -> rusqlite::Result<BTreeMap<i64, (i64, i64)>> {
    let mut statement = connection.prepare("SELECT span, oldest, newest FROM spans WHERE chain = ?")?;
    let spans = statement.query_map([chain.name()], |row| Ok((row.get(0)?, (row.get(1)?, row.get(2)?))))?;
    spans.collect()
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

impl Walk<'_> {
    fn find(&mut self, seq: i64, detail: impl std::fmt::Display) {
        self.verifier.find(format!("{} {seq}", self.chain.name()), detail);
    }

    fn row(&mut self, row: &Row<'_>) -> rusqlite::Result<()> {
        let count = match self.chain {
            Chain::Events => &mut self.verifier.report.events,
            Chain::Grips => &mut self.verifier.report.grips,
        };
        *count += 1;
        let seq: i64 = row.get(0)?;
        if seq != self.seq + 1 {
            self.find(self.seq + 1, format!("missing, up to {}", seq - 1));
            self.hashes.clear();
        }
        self.seq = seq;
        if let Some(raw) = raw(self.chain, row)? {
            self.record(&raw);
        } else {
            self.find(seq, "its columns are not of their types");
            self.hashes.clear();
        }
        Ok(())
    }

    fn record(&mut self, raw: &Raw<'_>) {
        let computed: Vec<_> = self.hashes.iter().map(|previous| hash(previous, raw.body, raw.curve)).collect();
        self.hashes = vec![raw.hash];
        if !computed.is_empty() && !computed.contains(&raw.hash) {
            self.find(raw.seq, "it is not as it was written (its hash is another)");
            self.hashes.extend(computed);
        }
        if self.chain == Chain::Grips && curve::decode(raw.curve).is_err() {
            self.find(raw.seq, curve::NoCurve);
        }
        let span = self.spans.get(&(raw.seq >> SPAN_BITS));
        if !span.is_some_and(|(oldest, newest)| (*oldest..=*newest).contains(&raw.at)) {
            self.find(raw.seq, "it is not found by its time");
        }
        match serde_json::from_slice(raw.body) {
            Ok(body) => self.body(raw, &body),
            Err(error) => self.find(raw.seq, format!("its body is no JSON: {error}")),
        }
    }

    fn body(&mut self, raw: &Raw<'_>, body: &Value) {
        if body["seq"].as_i64() != Some(raw.seq) {
            self.find(raw.seq, format!("its body says that it is {}", body["seq"]));
        }
        let time = &body[self.chain.time_field()];
        if time.as_str().and_then(|at| at.parse().ok()).map(milliseconds) != Some(raw.at) {
            self.find(raw.seq, format!("its body says that it was at {time}, and not at {} ms", raw.at));
        }
        if self.chain == Chain::Events {
            self.verifier.event(raw.seq, body);
        }
    }
}

impl Verifier {
    /// Takes from an event what the file keeps beside it.
    fn event(&mut self, seq: i64, body: &Value) {
        let text = |field: &str| body[field].as_str().unwrap_or_default().to_owned();
        match (body["kind"].as_str(), body["event"].as_str()) {
            (Some("command"), _) if body["outcome"].is_null() => {
                self.running.insert(text("command_id"), seq);
            }
            (Some("command"), _) => {
                self.running.remove(&text("command_id"));
            }
            (Some("gateway"), Some("pruned")) => {
                let seq = |field: &str| body[field].as_i64().unwrap_or_default();
                self.attested.insert(Chain::Events, (seq("up_to_seq"), text("hash")));
                self.attested.insert(Chain::Grips, (seq("grips_up_to_seq"), text("grips_hash")));
            }
            _ => {}
        }
    }
}
