//! Statistics of grips: one pass over an index that has all their figures, shared by two threads in a large journal.

use std::collections::BTreeMap;
use std::panic::resume_unwind;
use std::thread;

use jiff::Timestamp;
use rusqlite::types::{Value, ValueRef};
use rusqlite::{Connection, OptionalExtension as _, Row, params_from_iter};
use serde::{Deserialize, Serialize};
use strum::VariantArray as _;

use crate::journal::row::milliseconds;
use crate::journal::source::Source;
use crate::model::{Kind, Name, Outcome, PartId};

/// SQL that creates the index. Files of earlier versions get it when they are opened for writing.
pub(in crate::journal) const INDEX: &str = "
CREATE INDEX IF NOT EXISTS grips_statistics ON grips(
    part_id, at, gripper, outcome,
    body ->> '$.contact_width_mm', body ->> '$.force_n', body ->> '$.time_to_contact_ms'
) WHERE kind = 'grip';
";

/// Weight of the newest value in the moving average.
pub const NEWEST_WEIGHS: f64 = 0.2;

/// Number of records from which two threads share the work.
pub(in crate::journal) const SHARED_FROM: i64 = 100_000;

/// Grips that statistics cover.
#[derive(Debug, Clone, PartialEq)]
pub struct StatisticsQuery {
    pub part_id: Option<PartId>,
    pub gripper: Option<Name>,
    /// Earliest time, inclusive.
    pub from: Option<Timestamp>,
    /// Latest time, exclusive.
    pub to: Option<Timestamp>,
    /// Kind of the grips: `grip` or `reference`.
    pub kind: Kind,
    /// Number of the part's newest grips; all if absent. Needs a part, by which the index is sorted.
    pub window: Option<u32>,
}

/// Statistics of grips. The distributions are those of grips with a part, the right one or not.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GripStatistics {
    /// Number of grips by outcome.
    pub outcomes: BTreeMap<&'static str, u64>,
    pub contact_width_mm: Distribution,
    pub force_n: Distribution,
    pub time_to_contact_ms: Distribution,
    /// Exponentially weighted moving average of the contact widths, in mm; absent without a part in the query.
    pub moving_average_mm: Option<f64>,
    /// Times of the oldest and of the newest grip, in ms since 1970.
    pub times: Option<(i64, i64)>,
}

/// Distribution of values, computed in one pass (Welford 1962).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Distribution {
    pub count: u64,
    mean: f64,
    /// Sum of the squared distances from the mean.
    squares: f64,
    min: f64,
    max: f64,
}

/// A moving average that takes the newest value first.
#[derive(Debug)]
struct MovingAverage {
    sum: f64,
    /// Weight of all values that are older than those taken.
    rest: f64,
    oldest: Option<f64>,
}

impl GripStatistics {
    /// Number of grips.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.outcomes.values().sum()
    }
}

impl Distribution {
    /// Adds a value.
    pub fn take(&mut self, value: f64) {
        if self.count == 0 {
            (self.min, self.max) = (value, value);
        }
        self.count += 1;
        let before = value - self.mean;
        self.mean += before / self.count as f64;
        self.squares += before * (value - self.mean);
        (self.min, self.max) = (self.min.min(value), self.max.max(value));
    }

    /// Adds all values of another distribution (Chan 1979).
    fn append(&mut self, other: &Self) {
        if self.count == 0 || other.count == 0 {
            *self = if self.count == 0 { *other } else { *self };
            return;
        }
        let count = self.count + other.count;
        let distance = other.mean - self.mean;
        let share = other.count as f64 / count as f64;
        self.squares += other.squares + distance * distance * self.count as f64 * share;
        self.mean += distance * share;
        (self.min, self.max) = (self.min.min(other.min), self.max.max(other.max));
        self.count = count;
    }

    #[must_use]
    pub fn mean(&self) -> Option<f64> {
        (self.count > 0).then_some(self.mean)
    }

    /// Standard deviation of a sample, which needs two values.
    #[must_use]
    pub fn standard_deviation(&self) -> Option<f64> {
        (self.count > 1).then(|| (self.squares / (self.count - 1) as f64).sqrt())
    }

    /// Smallest and greatest value.
    #[must_use]
    pub fn range(&self) -> Option<(f64, f64)> {
        (self.count > 0).then_some((self.min, self.max))
    }
}

impl FromIterator<f64> for Distribution {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let mut distribution = Self::default();
        values.into_iter().for_each(|value| distribution.take(value));
        distribution
    }
}

impl Default for MovingAverage {
    fn default() -> Self {
        Self { sum: 0.0, rest: 1.0, oldest: None }
    }
}

impl MovingAverage {
    /// Takes the next older value.
    fn take(&mut self, value: f64) {
        self.sum += self.rest * NEWEST_WEIGHS * value;
        self.rest *= 1.0 - NEWEST_WEIGHS;
        self.oldest = Some(value);
    }

    /// Takes the values of an older average.
    fn append(&mut self, older: &Self) {
        self.sum += self.rest * older.sum;
        self.rest *= older.rest;
        self.oldest = older.oldest.or(self.oldest);
    }

    /// The average, which began with the oldest value.
    fn value(&self) -> Option<f64> {
        Some(self.sum + self.rest * self.oldest?)
    }
}

/// Figures of grips, taken from the newest to the oldest.
#[derive(Debug, Default)]
struct Tally {
    /// Numbers of grips, in the order of the outcomes.
    counts: [u64; Outcome::VARIANTS.len()],
    contact_width_mm: Distribution,
    force_n: Distribution,
    time_to_contact_ms: Distribution,
    average: MovingAverage,
    times: Option<(i64, i64)>,
}

impl Tally {
    fn of(connection: &Connection, query: &StatisticsQuery) -> rusqlite::Result<Self> {
        let (sql, values) = select(query);
        let mut statement = connection.prepare_cached(&sql)?;
        let mut rows = statement.query(params_from_iter(values))?;
        let mut tally = Self::default();
        while let Some(row) = rows.next()? {
            tally.take(row)?;
        }
        Ok(tally)
    }

    fn take(&mut self, row: &Row<'_>) -> rusqlite::Result<()> {
        let outcome = row.get_ref(0)?.as_bytes()?;
        let at = row.get(1)?;
        self.extend_times((at, at));
        let Some(index) = Outcome::VARIANTS.iter().position(|known| known.name().as_bytes() == outcome) else {
            return Ok(());
        };
        self.counts[index] += 1;
        if !Outcome::VARIANTS[index].holds_part() {
            return Ok(());
        }
        if let Some(width_mm) = number(row.get_ref(2)?) {
            self.contact_width_mm.take(width_mm);
            self.average.take(width_mm);
        }
        if let Some(force_n) = number(row.get_ref(3)?) {
            self.force_n.take(force_n);
        }
        if let Some(time_ms) = number(row.get_ref(4)?) {
            self.time_to_contact_ms.take(time_ms);
        }
        Ok(())
    }

    fn extend_times(&mut self, (oldest, newest): (i64, i64)) {
        let (known_oldest, known_newest) = self.times.unwrap_or((oldest, newest));
        self.times = Some((oldest.min(known_oldest), newest.max(known_newest)));
    }

    /// Takes all of an older tally.
    fn append(&mut self, older: &Self) {
        self.counts.iter_mut().zip(older.counts).for_each(|(count, more)| *count += more);
        self.contact_width_mm.append(&older.contact_width_mm);
        self.force_n.append(&older.force_n);
        self.time_to_contact_ms.append(&older.time_to_contact_ms);
        self.average.append(&older.average);
        if let Some(times) = older.times {
            self.extend_times(times);
        }
    }

    fn statistics(self, query: &StatisticsQuery) -> GripStatistics {
        let counted = Outcome::VARIANTS.iter().zip(self.counts).filter(|(_, count)| *count > 0);
        GripStatistics {
            outcomes: counted.map(|(outcome, count)| (outcome.name(), count)).collect(),
            contact_width_mm: self.contact_width_mm,
            force_n: self.force_n,
            time_to_contact_ms: self.time_to_contact_ms,
            moving_average_mm: self.average.value().filter(|_| query.part_id.is_some()),
            times: self.times,
        }
    }
}

/// Computes the statistics of the grips that a query covers. Two threads share a journal of `shared_from` records.
pub(in crate::journal) fn statistics(
    source: &Source,
    connection: &Connection,
    query: &StatisticsQuery,
    shared_from: i64,
) -> rusqlite::Result<GripStatistics> {
    let Some(middle) = middle(connection, query, shared_from)? else {
        return Ok(Tally::of(connection, query)?.statistics(query));
    };
    let older = StatisticsQuery { to: Some(middle), ..query.clone() };
    let newer = StatisticsQuery { from: Some(middle), ..query.clone() };
    let tally = thread::scope(|scope| {
        let older = scope.spawn(|| Tally::of(&source.reading()?, &older));
        let newer = Tally::of(connection, &newer);
        let older = older.join().unwrap_or_else(|panic| resume_unwind(panic));
        let mut tally = newer?;
        tally.append(&older?);
        Ok::<_, rusqlite::Error>(tally)
    })?;
    Ok(tally.statistics(query))
}

/// Returns the time of the journal's middle record, if a query covers so many records that a second thread
/// saves time.
fn middle(connection: &Connection, query: &StatisticsQuery, shared_from: i64) -> rusqlite::Result<Option<Timestamp>> {
    if query.from.is_some() || query.to.is_some() || query.window.is_some() {
        return Ok(None);
    }
    let ends = "SELECT (SELECT coalesce(min(seq), 0) FROM grips), (SELECT coalesce(max(seq), 0) FROM grips)";
    let (first, last): (i64, i64) =
        connection.prepare_cached(ends)?.query_row([], |row| Ok((row.get(0)?, row.get(1)?)))?;
    if last - first < shared_from {
        return Ok(None);
    }
    let mut statement = connection.prepare_cached("SELECT at FROM grips WHERE seq >= ? ORDER BY seq LIMIT 1")?;
    let at: Option<i64> = statement.query_row([first + (last - first) / 2], |row| row.get(0)).optional()?;
    Ok(at.and_then(|at| Timestamp::from_millisecond(at).ok()))
}

/// Returns the SQL that selects the figures of a query's grips, and its parameters.
fn select(query: &StatisticsQuery) -> (String, Vec<Value>) {
    // The index has only records of the kind `grip`. Reference grips are few, and need none.
    let (mut conditions, index) = match query.kind {
        Kind::Grip => (String::from("kind = 'grip'"), "INDEXED BY grips_statistics"),
        other => (format!("kind = '{}'", other.name()), ""),
    };
    let mut values: Vec<Value> = Vec::new();
    let given = [
        ("part_id = ?", query.part_id.as_ref().map(|part_id| Value::from(part_id.as_str().to_owned()))),
        ("gripper = ?", query.gripper.as_ref().map(|gripper| Value::from(gripper.to_string()))),
        ("at >= ?", query.from.map(|from| milliseconds(from).into())),
        ("at < ?", query.to.map(|to| milliseconds(to).into())),
    ];
    for (condition, value) in given {
        if let Some(value) = value {
            conditions.push_str(" AND ");
            conditions.push_str(condition);
            values.push(value);
        }
    }
    // Without a part, the order does not matter, and sorting would take long.
    let order = if query.part_id.is_some() { "ORDER BY at DESC LIMIT ?" } else { "LIMIT ?" };
    values.push(query.window.map_or(i64::MAX, i64::from).into());
    let sql = format!(
        "SELECT outcome, at, body ->> '$.contact_width_mm', body ->> '$.force_n', body ->> '$.time_to_contact_ms'
         FROM grips {index} WHERE {conditions} {order}"
    );
    (sql, values)
}

fn number(value: ValueRef<'_>) -> Option<f64> {
    match value {
        ValueRef::Real(number) => Some(number),
        ValueRef::Integer(number) => Some(number as f64),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_close(a: Option<f64>, b: f64) -> bool {
        a.is_some_and(|a| (a - b).abs() < 1e-12)
    }

    #[test]
    fn distribution_is_that_of_a_sample() {
        let values: Distribution = [19.0, 20.0, 21.0].into_iter().collect();
        assert!(is_close(values.mean(), 20.0) && is_close(values.standard_deviation(), 1.0), "{values:?}");
        assert_eq!(values.range(), Some((19.0, 21.0)));
        let one: Distribution = [-1.0].into_iter().collect();
        assert_eq!((one.mean(), one.standard_deviation(), one.range()), (Some(-1.0), None, Some((-1.0, -1.0))));
        let none = Distribution::default();
        assert_eq!((none.mean(), none.range()), (None, None));
    }

    #[test]
    fn appended_distributions_equal_one_of_all_values() {
        let values = [19.0, 20.5, 21.0, 4.0, -1.0];
        let all: Distribution = values.into_iter().collect();
        for parts in (0..=values.len()).map(|middle| values.split_at(middle)) {
            let mut one: Distribution = parts.0.iter().copied().collect();
            one.append(&parts.1.iter().copied().collect());
            assert_eq!((one.count, one.range()), (all.count, all.range()));
            assert!(is_close(one.mean(), all.mean().unwrap()));
            assert!(is_close(one.standard_deviation(), all.standard_deviation().unwrap()));
        }
    }

    #[test]
    fn moving_average_begins_with_the_oldest_value() {
        let values = [20.0, 20.5, 19.0, 21.0];
        let expected = values.into_iter().reduce(|average, value| 0.8 * average + 0.2 * value);
        let mut average = MovingAverage::default();
        values.iter().rev().for_each(|value| average.take(*value));
        assert!(is_close(average.value(), expected.unwrap()));
        let (mut newer, mut older) = (MovingAverage::default(), MovingAverage::default());
        values[2..].iter().rev().for_each(|value| newer.take(*value));
        values[..2].iter().rev().for_each(|value| older.take(*value));
        newer.append(&older);
        newer.append(&MovingAverage::default());
        assert!(is_close(newer.value(), expected.unwrap()));
        assert_eq!(MovingAverage::default().value(), None);
    }
}
