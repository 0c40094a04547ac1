//! Events that a removal for the file's size leaves: FAST STOPs, and records of access. Each of the two shares has a
//! part of the file that no other record can take, so a flood of other records cannot push them out.
//!
//! An event that stays loses its neighbours in the chain of events. Therefore it is listed in its share with the hash of
//! the event before, and each entry of a share has a link that covers the entry before. After a removal, an event of
//! kind `gateway` attests both ends of each share.

use rusqlite::{Connection, OptionalExtension as _, Transaction, params};
use sha2::{Digest, Sha256};

use super::chain::{Chain, Hash, Tip};
use super::store::{anchor, remove_spans};
use crate::model::{GatewayEvent, KeptShare};

/// SQL that creates the table of entries. `previous` is the hash of the event before, `link` the entry's link, and
/// `total` the sum of the bytes of this entry's event and of those before it.
pub(super) const TABLE: &str = "
CREATE TABLE IF NOT EXISTS kept(
    share TEXT NOT NULL, seq INTEGER NOT NULL, previous BLOB NOT NULL, link BLOB NOT NULL, total INTEGER NOT NULL,
    PRIMARY KEY(share, seq)
) STRICT, WITHOUT ROWID";

/// Bytes that an event takes in the file besides its body: hashes, indexes and page overhead.
const OVERHEAD: i64 = 300;

/// Part of the file's size limit that each share may take, as a divisor.
const PART: u64 = 20;

/// A share of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Share {
    /// FAST STOPs and their acknowledgements.
    FastStops,
    /// Refused requests, leases taken by force, and what the gateway records of itself.
    Access,
}

impl Share {
    pub(super) const ALL: [Self; 2] = [Self::FastStops, Self::Access];

    /// Name of the share in the table and in events.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::FastStops => "fast_stops",
            Self::Access => "access",
        }
    }

    /// Name of the share's row in `anchors`, which has the newest entry that was removed from the share.
    const fn anchor(self) -> &'static str {
        match self {
            Self::FastStops => "kept fast_stops",
            Self::Access => "kept access",
        }
    }

    /// SQL condition of the share's events.
    const fn condition(self) -> &'static str {
        match self {
            Self::FastStops => "kind IN ('fast_stop', 'acknowledge')",
            Self::Access => {
                "kind = 'refused' OR kind = 'lease' AND body ->> '$.event' = 'forced'
                 OR kind = 'gateway' AND body ->> '$.event' NOT IN ('pruned', 'kept', 'head')"
            }
        }
    }
}

/// Link of an entry that follows another.
pub(super) fn link(previous: &Hash, seq: i64, event: &Hash) -> Hash {
    Sha256::new().chain_update(previous).chain_update(seq.to_be_bytes()).chain_update(event).finalize().into()
}

/// Returns the entry before the first of a share.
pub(super) fn beginning(connection: &Connection, share: Share) -> rusqlite::Result<Tip> {
    let sql = "SELECT seq, hash FROM anchors WHERE chain = ?";
    let tip = connection.query_row(sql, [share.anchor()], Tip::of_row).optional()?;
    Ok(tip.unwrap_or_default())
}

/// Returns the newest entry of a share; the one before the first if the share is empty.
pub(super) fn end(connection: &Connection, share: Share) -> rusqlite::Result<Tip> {
    let sql = "SELECT seq, link FROM kept WHERE share = ? ORDER BY seq DESC LIMIT 1";
    match connection.query_row(sql, [share.name()], Tip::of_row).optional()? {
        Some(tip) => Ok(tip),
        None => beginning(connection, share),
    }
}

/// Enters the events up to `last` that stay when the others are removed.
pub(super) fn enter(transaction: &Transaction<'_>, last: i64) -> rusqlite::Result<()> {
    let removed = anchor(transaction, Chain::Events)?;
    for share in Share::ALL {
        let newest = end(transaction, share)?;
        let mut total = total(transaction, share)?;
        let mut link_before = newest.hash;
        let sql = format!(
            "SELECT seq, hash, length(body), coalesce((SELECT before.hash FROM events AS before
                 WHERE before.seq = events.seq - 1), ?3)
             FROM events NOT INDEXED WHERE seq > ?1 AND seq <= ?2 AND ({}) ORDER BY seq",
            share.condition()
        );
        let mut statement = transaction.prepare_cached(&sql)?;
        let mut rows = statement.query(params![removed.seq, last, removed.hash])?;
        while let Some(row) = rows.next()? {
            let seq: i64 = row.get(0)?;
            let hash: Hash = row.get(1)?;
            let bytes: i64 = row.get(2)?;
            let previous: Hash = row.get(3)?;
            total += bytes + OVERHEAD;
            link_before = link(&link_before, seq, &hash);
            let insert = "INSERT INTO kept(share, seq, previous, link, total) VALUES (?, ?, ?, ?, ?)";
            transaction.prepare_cached(insert)?.execute(params![share.name(), seq, previous, link_before, total])?;
        }
    }
    Ok(())
}

fn total(connection: &Connection, share: Share) -> rusqlite::Result<i64> {
    let sql = "SELECT total FROM kept WHERE share = ? ORDER BY seq DESC LIMIT 1";
    let total = connection.query_row(sql, [share.name()], |row| row.get(0)).optional()?;
    Ok(total.unwrap_or_default())
}

/// Entries that a share may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum KeptLimit {
    /// As many as take a part of the file, whose size limit is this many bytes.
    Size(u64),
    /// Those from this time on, in ms since 1970.
    Age(i64),
}

/// Removes up to `step` entries of each share that are beyond its limit, the oldest first, with their events. Returns
/// whether there were any.
pub(super) fn trim(transaction: &Transaction<'_>, limit: KeptLimit, step: i64) -> rusqlite::Result<bool> {
    let mut has_removed = false;
    for share in Share::ALL {
        let newest = total(transaction, share)?;
        let sql = "SELECT kept.seq, link, total, at FROM kept LEFT JOIN events ON events.seq = kept.seq
                   WHERE share = ? ORDER BY kept.seq LIMIT ?";
        let mut removed: Option<Tip> = None;
        let mut statement = transaction.prepare_cached(sql)?;
        let mut rows = statement.query(params![share.name(), step])?;
        while let Some(row) = rows.next()? {
            let total: i64 = row.get(2)?;
            let at: Option<i64> = row.get(3)?;
            let is_beyond = match limit {
                KeptLimit::Size(bytes) => (newest - total).unsigned_abs() >= bytes / PART,
                KeptLimit::Age(before) => at.is_none_or(|at| at < before),
            };
            if !is_beyond {
                break;
            }
            removed = Some(Tip::of_row(row)?);
        }
        if let Some(removed) = removed {
            remove(transaction, share, removed)?;
            has_removed = true;
        }
    }
    Ok(has_removed)
}

/// Removes the entries of a share up to this one.
fn remove(transaction: &Transaction<'_>, share: Share, last: Tip) -> rusqlite::Result<()> {
    let first = beginning(transaction, share)?.seq;
    let of_share = "SELECT seq FROM kept WHERE share = ? AND seq <= ?";
    transaction.execute(&format!("DELETE FROM events WHERE seq IN ({of_share})"), params![share.name(), last.seq])?;
    transaction.execute("DELETE FROM kept WHERE share = ? AND seq <= ?", params![share.name(), last.seq])?;
    let sql = "INSERT OR REPLACE INTO anchors(chain, seq, hash) VALUES (?, ?, ?)";
    transaction.execute(sql, params![share.anchor(), last.seq, last.hash])?;
    remove_spans(transaction, Chain::Events, first, last.seq)
}

/// Returns the event that attests both ends of the shares; `None` if nothing was kept so far.
pub(super) fn attestation(connection: &Connection) -> rusqlite::Result<Option<GatewayEvent>> {
    let mut shares = Vec::new();
    for share in Share::ALL {
        let from = beginning(connection, share)?;
        let up_to = end(connection, share)?;
        if up_to != Tip::default() {
            shares.push(kept_share(share, from, up_to));
        }
    }
    Ok((!shares.is_empty()).then_some(GatewayEvent::Kept { shares }))
}

/// Returns the attestation that a removal lacks because the gateway was killed in the middle of it.
pub(super) fn unattested(connection: &Connection) -> rusqlite::Result<Option<GatewayEvent>> {
    let sql = "SELECT body ->> '$.event' FROM events
               WHERE kind = 'gateway' AND body ->> '$.event' IN ('pruned', 'kept') ORDER BY seq DESC LIMIT 1";
    let newest: Option<String> = connection.query_row(sql, [], |row| row.get(0)).optional()?;
    if newest.as_deref() == Some("pruned") { attestation(connection) } else { Ok(None) }
}

/// Returns the time of the oldest event of all shares, in ms since 1970.
pub(super) fn oldest(connection: &Connection) -> rusqlite::Result<Option<i64>> {
    let mut oldest = None;
    for share in Share::ALL {
        let sql = "SELECT at FROM kept JOIN events USING (seq) WHERE share = ? ORDER BY kept.seq LIMIT 1";
        let at: Option<i64> = connection.query_row(sql, [share.name()], |row| row.get(0)).optional()?;
        oldest = at.into_iter().chain(oldest).min();
    }
    Ok(oldest)
}

/// Describes both ends of a share.
pub(super) fn kept_share(share: Share, from: Tip, up_to: Tip) -> KeptShare {
    KeptShare {
        share: share.name().to_owned(),
        from_seq: from.seq,
        from_hash: hex::encode(from.hash),
        up_to_seq: up_to.seq,
        hash: hex::encode(up_to.hash),
    }
}

/// Counts the events kept after `after` and up to `until`.
pub(super) fn count(connection: &Connection, after: i64, until: i64) -> rusqlite::Result<i64> {
    let sql = "SELECT count(*) FROM kept WHERE share IN ('fast_stops', 'access') AND seq > ? AND seq <= ?";
    connection.prepare_cached(sql)?.query_row([after, until], |row| row.get(0))
}
