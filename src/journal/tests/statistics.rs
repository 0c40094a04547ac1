//! Statistics of grips, computed by one thread and by two.

use super::super::reading::statistics::{SHARED_FROM, statistics};
use super::super::source::Source;
use super::super::store::{PersistedValues, Store};
use super::super::{Distribution, GripStatistics, StatisticsQuery};
use super::super::{chain::Tip, row::Row};
use super::*;

fn query(part_id: Option<&str>, kind: Kind) -> StatisticsQuery {
    let part_id = part_id.and_then(PartId::new);
    StatisticsQuery { part_id, gripper: None, from: None, to: None, kind, window: None }
}

/// Rounds what depends on the order of additions.
fn rounded(statistics: &GripStatistics) -> String {
    let of = |values: &Distribution| (values.count, values.range(), values.mean().map(|mean| format!("{mean:.9}")));
    let widths = &statistics.contact_width_mm;
    let deviation = widths.standard_deviation().map(|deviation| format!("{deviation:.9}"));
    let figures = (of(widths), deviation, of(&statistics.force_n), of(&statistics.time_to_contact_ms));
    let average = statistics.moving_average_mm.map(|average| format!("{average:.9}"));
    format!("{:?} {:?} {figures:?} {average:?}", statistics.outcomes, statistics.times)
}

#[test]
fn two_threads_compute_the_same() {
    let directory = Directory::new();
    let mut store = Store::open(directory.place()).unwrap();
    let (mut rows, mut end) = (Vec::new(), Tip::default());
    for number in 0..200 {
        let contact_width_mm = Some(20.0 + (number % 7) as f32 / 10.0);
        let outcome = if number % 9 == 0 { Outcome::NoPart } else { Outcome::PartHeld };
        let kind = if number % 5 == 0 { Kind::Reference } else { Kind::Grip };
        let part_id = Some(if number % 3 == 0 { "A" } else { "B" });
        let of_part = grip(i64::from(number) * 10, "left", number, part_id);
        let row = Row::grip(end, &GripRecord { kind, outcome, contact_width_mm, ..of_part }).unwrap();
        end = row.tip;
        rows.push(row);
    }
    store.commit(&rows, &PersistedValues::new()).unwrap();
    let source: &Source = &store.source;
    for query in [None, Some("A"), Some("B"), Some("none")]
        .into_iter()
        .flat_map(|part_id| [Kind::Grip, Kind::Reference].map(|kind| query(part_id, kind)))
    {
        let [one, two] = [SHARED_FROM, 1].map(|from| statistics(source, &store.connection, &query, from).unwrap());
        assert_eq!(rounded(&one), rounded(&two), "{query:?}");
        let has_grips = query.part_id.as_ref().is_none_or(|part_id| part_id.as_str() != "none");
        assert_eq!(one.count() > 0, has_grips, "{query:?}");
    }
}
