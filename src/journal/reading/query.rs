//! Queries for pages of records, which read no more records than they return.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use jiff::Timestamp;
use rusqlite::Connection;
use rusqlite::types::Value;
use strum::{EnumMessage, VariantArray};

use super::time_ranges::{Run, runs};
use crate::journal::chain::Chain;
use crate::journal::row::{EventKind, Stored, milliseconds, word};
use crate::model::{CommandId, Kind, Name, Outcome, PartId};

pub type EventQuery = Query<EventKind>;

pub type GripQuery = Query<Kind>;

/// Query for a page of records.
#[derive(Debug, Clone, PartialEq)]
pub struct Query<K> {
    pub filter: Filter<K>,
    /// Earliest time, inclusive.
    pub from: Option<Timestamp>,
    /// Latest time, exclusive.
    pub to: Option<Timestamp>,
    pub limit: Limit,
    /// Record after which the page begins, in this order.
    pub cursor: Option<Cursor>,
    pub order: Order,
}

impl<K> Default for Query<K> {
    fn default() -> Self {
        let filter = Filter::default();
        let limit = Limit::default();
        let order = Order::default();
        Self { filter, from: None, to: None, limit, cursor: None, order }
    }
}

/// Values that records must have; an absent value matches all.
#[derive(Debug, Clone, PartialEq)]
pub struct Filter<K> {
    pub gripper: Option<Name>,
    pub kind: Option<K>,
    pub part_id: Option<PartId>,
    /// Beginning of the part's id.
    pub part_prefix: Option<PartId>,
    pub outcome: Option<Outcome>,
    /// Id of the command; for grip records their own id.
    pub command_id: Option<CommandId>,
}

impl<K> Default for Filter<K> {
    fn default() -> Self {
        Self { gripper: None, kind: None, part_id: None, part_prefix: None, outcome: None, command_id: None }
    }
}

impl Filter<EventKind> {
    /// Whether an event passes the filter.
    #[must_use]
    pub fn matches(&self, event: &Stored) -> bool {
        fn allows<T: PartialEq>(asked: Option<&T>, is: Option<&T>) -> bool {
            asked.is_none() || asked == is
        }
        allows(self.gripper.as_ref(), event.gripper.as_ref())
            && allows(self.kind.as_ref(), Some(&event.kind))
            && allows(self.part_id.as_ref(), event.part_id.as_ref())
            && self.part_prefix.as_ref().is_none_or(|prefix| {
                event.part_id.as_ref().is_some_and(|part_id| part_id.as_str().starts_with(prefix.as_str()))
            })
            && allows(self.outcome.as_ref(), event.outcome.as_ref())
            && allows(self.command_id.as_ref(), event.command_id.as_ref())
    }
}

/// Order of records by sequence number.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Default,
    serde::Serialize,
    serde::Deserialize,
    utoipa::ToSchema,
    EnumMessage,
    VariantArray,
)]
#[serde(rename_all = "lowercase")]
pub enum Order {
    /// Newest first.
    #[default]
    Newest,
    /// Oldest first.
    Oldest,
}

/// Maximum number of records on a page, from 1 to 1000.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limit(u16);

impl Limit {
    /// # Errors
    /// [`InvalidLimit`], if the number is not from 1 to 1000.
    pub fn new(limit: u64) -> Result<Self, InvalidLimit> {
        match u16::try_from(limit) {
            Ok(limit @ 1..=1000) => Ok(Self(limit)),
            _ => Err(InvalidLimit(limit)),
        }
    }
}

impl Default for Limit {
    fn default() -> Self {
        Self(100)
    }
}

/// Error of a number that is not a [`Limit`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("limit is {0}; it must be from 1 to 1000: use the cursor to get more records")]
pub struct InvalidLimit(u64);

/// Position where the next page begins. Clients send it back unchanged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cursor(i64);

impl Cursor {
    /// Begins after the record with this sequence number.
    #[must_use]
    pub fn after(seq: i64) -> Self {
        Self(seq)
    }

    pub(in crate::journal) fn seq(self) -> i64 {
        self.0
    }
}

impl fmt::Display for Cursor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl FromStr for Cursor {
    type Err = InvalidCursor;

    fn from_str(text: &str) -> Result<Self, InvalidCursor> {
        text.parse().map(Self).map_err(|_| InvalidCursor(text.to_owned()))
    }
}

/// Error of a text that is not a [`Cursor`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a cursor: send next_cursor of the previous page unchanged, or no cursor for the first page")]
pub struct InvalidCursor(String);

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Page {
    /// The records as JSON.
    pub bodies: Vec<Arc<str>>,
    /// Cursor of the next page; absent on the last.
    pub next_cursor: Option<String>,
    /// Cursor for later records; absent if the newest records come first.
    pub resume_cursor: Option<String>,
}

/// The kinds of one chain's records.
pub(in crate::journal) trait ChainKind: Copy + PartialEq + serde::Serialize {
    const CHAIN: Chain;
    /// The kind of most records that have a part.
    const WITH_PART: Self;
    /// The only other kind that can have a part. There are few records of it.
    const ALSO_WITH_PART: Self;
    /// The only kind that can have an outcome; absent if every kind has one.
    const WITH_OUTCOME: Option<Self>;
}

impl ChainKind for EventKind {
    const CHAIN: Chain = Chain::Events;
    const WITH_PART: Self = Self::Command;
    const ALSO_WITH_PART: Self = Self::Alarm;
    const WITH_OUTCOME: Option<Self> = Some(Self::Command);
}

impl ChainKind for Kind {
    const CHAIN: Chain = Chain::Grips;
    const WITH_PART: Self = Self::Grip;
    const ALSO_WITH_PART: Self = Self::Reference;
    const WITH_OUTCOME: Option<Self> = None;
}

/// Conditions on columns, and an index for them.
struct Plan {
    index: String,
    /// Whether the index is read over a range of part ids.
    is_by_prefix: bool,
    /// Kind of records to leave out, by the index of kinds.
    without: Option<String>,
    /// Columns, each with an operator and a value.
    conditions: Vec<(&'static str, &'static str, String)>,
}

/// Chooses the conditions and the index for a filter. Returns `None` if no record can match.
fn plan<K: ChainKind>(filter: &Filter<K>) -> Option<Plan> {
    let has_part = filter.part_id.is_some() || filter.part_prefix.is_some();
    if let Some(kind) = filter.kind {
        let can_have_part = [K::WITH_PART, K::ALSO_WITH_PART].contains(&kind);
        let can_have_outcome = K::WITH_OUTCOME.is_none_or(|with_outcome| with_outcome == kind);
        if (has_part && !can_have_part) || (filter.outcome.is_some() && !can_have_outcome) {
            return None;
        }
    }
    let mut of_part = Vec::new();
    of_part.extend(filter.part_id.as_ref().map(|part_id| ("part_id", "=", part_id.as_str().to_owned())));
    if let Some(prefix) = &filter.part_prefix {
        let end = format!("{}{}", prefix.as_str(), char::MAX);
        of_part.extend([("part_id", ">=", prefix.as_str().to_owned()), ("part_id", "<", end)]);
    }
    let has_other_kind = has_part && filter.kind == Some(K::ALSO_WITH_PART);
    // The kind follows from the outcome or from `without`.
    let is_implied = (has_part && !has_other_kind) || (filter.outcome.is_some() && K::WITH_OUTCOME.is_some());
    let mut conditions = Vec::new();
    conditions.extend(filter.gripper.as_ref().map(|gripper| ("gripper", "=", gripper.to_string())));
    conditions.extend(filter.kind.filter(|_| !is_implied).map(|kind| ("kind", "=", word(&kind))));
    // Records of this kind are few, so their part is compared after the index.
    let further = if has_other_kind { std::mem::take(&mut of_part) } else { Vec::new() };
    conditions.extend(of_part);
    conditions.extend(filter.outcome.map(|outcome| ("outcome", "=", word(&outcome))));
    let mut columns: Vec<_> = conditions.iter().map(|(column, ..)| *column).collect();
    columns.dedup();
    let table = K::CHAIN.name();
    // A command has few records, so the other conditions can read them all.
    let index = match filter.command_id {
        Some(_) => format!("INDEXED BY {table}_command_id"),
        None if columns.is_empty() => "NOT INDEXED".to_owned(),
        None => format!("INDEXED BY {table}_{}", columns.join("_")),
    };
    conditions.extend(further);
    conditions.extend(filter.command_id.map(|id| ("command_id", "=", id.to_string())));
    let is_by_prefix = filter.part_prefix.is_some() && !has_other_kind;
    let without = (has_part && filter.kind == Some(K::WITH_PART)).then(|| word(&K::ALSO_WITH_PART));
    Some(Plan { index, is_by_prefix, without, conditions })
}

impl Chain {
    /// Columns of a served record: body, time at which a grip's part was lost, and whether the record is a grip.
    fn served(self) -> &'static str {
        match self {
            Self::Events => "body, NULL, 0",
            Self::Grips => {
                "body, (SELECT lost.body ->> '$.at' FROM events AS lost INDEXED BY events_command_id
                 WHERE lost.command_id = grips.command_id AND lost.kind = 'device'
                 AND lost.body ->> '$.event' = 'part_lost' ORDER BY lost.seq LIMIT 1), 1"
            }
        }
    }
}

/// Reads the grip record of a command, in the form that pages have.
pub(in crate::journal) fn grip(connection: &Connection, id: CommandId) -> rusqlite::Result<Option<Arc<str>>> {
    let filter = Filter { command_id: Some(id), ..Filter::default() };
    Ok(page(connection, &GripQuery { filter, ..GripQuery::default() }, i64::MAX)?.bodies.pop())
}

/// Reads a page of records up to `until`.
pub(in crate::journal) fn page<K: ChainKind>(
    connection: &Connection,
    query: &Query<K>,
    until: i64,
) -> rusqlite::Result<Page> {
    let cursor = query.cursor.map(|Cursor(seq)| seq);
    let Some(plan) = plan(&query.filter) else {
        return Ok(Page { resume_cursor: resume_after(query, None), ..Page::default() });
    };
    let (first, last) = match query.order {
        Order::Newest => (0, cursor.map_or(until, |seq| until.min(seq.saturating_sub(1)))),
        Order::Oldest => (cursor.map_or(0, |seq| seq.saturating_add(1)), until),
    };
    let limit = usize::from(query.limit.0);
    let mut found = Vec::new();
    let mut runs = runs(connection, K::CHAIN, (query.from, query.to), (first, last), query.order)?;
    if plan.is_by_prefix
        && let [one, .., other] = runs.as_slice()
    {
        // Each run would read the index's entries of all parts with this prefix again.
        runs = vec![Run { first: one.first.min(other.first), last: one.last.max(other.last), whole: false }];
    }
    for run in runs {
        // One record beyond the limit shows that another page follows.
        read_run(connection, &plan, query, run, limit + 1, &mut found)?;
        if found.len() > limit {
            break;
        }
    }
    let more = found.len() > limit;
    found.truncate(limit);
    let next_cursor = found.last().filter(|_| more).map(|(seq, _)| Cursor(*seq).to_string());
    let resume_cursor = resume_after(query, found.last().map(|(seq, _)| *seq));
    Ok(Page { bodies: found.into_iter().map(|(_, body)| body).collect(), next_cursor, resume_cursor })
}

/// Returns the cursor for later records than those of a page, of which `last` is the last.
fn resume_after<K>(query: &Query<K>, last: Option<i64>) -> Option<String> {
    let cursor = query.cursor.map(Cursor::seq);
    (query.order == Order::Oldest).then(|| last.or(cursor).unwrap_or(0).to_string())
}

fn read_run<K: ChainKind>(
    connection: &Connection,
    plan: &Plan,
    query: &Query<K>,
    run: Run,
    enough: usize,
    found: &mut Vec<(i64, Arc<str>)>,
) -> rusqlite::Result<()> {
    let tests = plan.conditions.iter().map(|(column, operator, _)| format!("{column} {operator} ? AND "));
    let chain = K::CHAIN;
    let order = if query.order == Order::Newest { "DESC" } else { "ASC" };
    let table = chain.name();
    let served_columns = chain.served();
    let without = plan
        .without
        .iter()
        .map(|kind| format!("seq NOT IN (SELECT seq FROM {table} INDEXED BY {table}_kind WHERE kind = '{kind}') AND "));
    let mut conditions: String = tests.chain(without).collect();
    let mut values: Vec<Value> = plan.conditions.iter().map(|(.., value)| value.clone().into()).collect();
    if !run.whole {
        conditions.push_str("at >= ? AND at < ? AND ");
        values.push(query.from.map_or(i64::MIN, milliseconds).into());
        values.push(query.to.map_or(i64::MAX, milliseconds).into());
    }
    let limit = i64::try_from(enough - found.len()).unwrap_or(i64::MAX);
    values.extend([run.first.into(), run.last.into(), limit.into()]);
    let columns = if plan.is_by_prefix { "seq".to_owned() } else { format!("seq, {served_columns}") };
    let index = &plan.index;
    let mut sql = format!(
        "SELECT {columns} FROM {table} {index} WHERE {conditions} seq BETWEEN ? AND ? ORDER BY seq {order} LIMIT ?"
    );
    if plan.is_by_prefix {
        // The parts of a prefix are in the order of their names, so the index alone finds the numbers to sort.
        sql = format!("SELECT seq, {served_columns} FROM {table} WHERE seq IN ({sql}) ORDER BY seq {order}");
    }
    let mut statement = connection.prepare_cached(&sql)?;
    let mut rows = statement.query(rusqlite::params_from_iter(values))?;
    while let Some(row) = rows.next()? {
        found.push((row.get(0)?, served(row.get_ref(1)?.as_str()?, row.get(2)?, row.get(3)?)));
    }
    Ok(())
}

/// Returns the body as served: a grip gets `part_lost_at` at its end.
fn served(body: &str, part_lost_at: Option<String>, is_grip: bool) -> Arc<str> {
    if !is_grip {
        return body.into();
    }
    let lost = part_lost_at.map_or("null".to_owned(), |at| format!("\"{at}\""));
    format!("{},\"part_lost_at\":{lost}}}", body.strip_suffix('}').unwrap_or(body)).into()
}
