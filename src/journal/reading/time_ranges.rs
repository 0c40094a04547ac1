//! Time ranges as runs of sequence numbers. Wall clocks jump, so the records of one time range can form several runs.

use jiff::Timestamp;
use rusqlite::{Connection, params};

use super::query::Order;
use crate::journal::chain::Chain;
use crate::journal::row::milliseconds;
use crate::journal::schema::SPAN_BITS;

/// Sequence numbers that contain records of a time range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::journal) struct Run {
    pub(in crate::journal) first: i64,
    pub(in crate::journal) last: i64,
    /// Whether all of these records are within the time range.
    pub(in crate::journal) whole: bool,
}

/// Returns the runs of a time range (from, to) between the sequence numbers `first` and `last`, in order.
pub(in crate::journal) fn runs(
    connection: &Connection,
    chain: Chain,
    (from, to): (Option<Timestamp>, Option<Timestamp>),
    (first, last): (i64, i64),
    order: Order,
) -> rusqlite::Result<Vec<Run>> {
    if from.is_none() && to.is_none() {
        return Ok(vec![Run { first, last, whole: true }]);
    }
    let from = from.map_or(i64::MIN, milliseconds);
    let to = to.map_or(i64::MAX, milliseconds);
    let mut statement = connection.prepare_cached(
        "SELECT span, oldest >= ?2 AND newest < ?3 FROM spans
         WHERE chain = ?1 AND newest >= ?2 AND oldest < ?3 AND span BETWEEN ?4 AND ?5 ORDER BY span",
    )?;
    let mut rows = statement.query(params![chain.name(), from, to, first >> SPAN_BITS, last >> SPAN_BITS])?;
    let mut runs: Vec<Run> = Vec::new();
    while let Some(row) = rows.next()? {
        let span: i64 = row.get(0)?;
        let whole: bool = row.get(1)?;
        let begin = span << SPAN_BITS;
        let end = (begin | ((1 << SPAN_BITS) - 1)).min(last);
        match runs.last_mut() {
            Some(before) if before.last == begin - 1 && before.whole == whole => before.last = end,
            _ => runs.push(Run { first: begin.max(first), last: end, whole }),
        }
    }
    if order == Order::Newest {
        runs.reverse();
    }
    Ok(runs)
}
