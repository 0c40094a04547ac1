//! Pages, compared with a filter that reads everything, and timed.

use rand::rngs::SmallRng;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rustix::time::{ClockId, clock_gettime};

use super::super::chain::{Chain, Tip};
use super::super::reading::query::{ChainKind, page};
use super::super::row::{Row, milliseconds};
use super::super::store::{PersistedValues, Store};
use super::*;
use crate::model::{AlarmCause, AlarmEvent, AlarmId, AlarmKind, AlarmStep};

/// The values of a record that filters compare.
struct Known<K> {
    seq: i64,
    at: i64,
    gripper: Option<Name>,
    kind: K,
    part_id: Option<PartId>,
    outcome: Option<Outcome>,
}

fn matches<K: ChainKind>(known: &Known<K>, query: &Query<K>) -> bool {
    let filter = &query.filter;
    filter.gripper.as_ref().is_none_or(|gripper| known.gripper.as_ref() == Some(gripper))
        && filter.kind.is_none_or(|kind| known.kind == kind)
        && filter.part_id.as_ref().is_none_or(|part_id| known.part_id.as_ref() == Some(part_id))
        && filter.part_prefix.as_ref().is_none_or(|prefix| {
            known.part_id.as_ref().is_some_and(|part_id| part_id.as_str().starts_with(prefix.as_str()))
        })
        && filter.outcome.is_none_or(|outcome| known.outcome == Some(outcome))
        && query.from.is_none_or(|from| known.at >= milliseconds(from))
        && query.to.is_none_or(|to| known.at < milliseconds(to))
}

/// Reads all pages of a query. Returns the sequence numbers of the records.
fn paged<K: ChainKind>(store: &Store, mut query: Query<K>) -> Vec<i64> {
    let mut seqs = Vec::new();
    loop {
        let page = page(&store.connection, &query, i64::MAX).unwrap();
        for body in &page.bodies {
            seqs.push(serde_json::from_str::<serde_json::Value>(body).unwrap()["seq"].as_i64().unwrap());
        }
        match page.next_cursor {
            Some(cursor) => query.cursor = Some(cursor.parse().unwrap()),
            None => return seqs,
        }
    }
}

fn expected<K: ChainKind>(known: &[Known<K>], query: &Query<K>) -> Vec<i64> {
    let mut seqs: Vec<_> = known.iter().filter(|known| matches(known, query)).map(|known| known.seq).collect();
    if query.order == Order::Newest {
        seqs.reverse();
    }
    seqs
}

/// Advances a clock, which sometimes jumps.
fn tick(random: &mut SmallRng, time: &mut i64) -> i64 {
    *time += match random.random_range(0..500) {
        0 => -50_000,
        1 => 50_000,
        _ => 10,
    };
    *time
}

const EVENT_KINDS: [EventKind; 4] = [EventKind::Command, EventKind::Link, EventKind::Alarm, EventKind::Lease];
const GRIP_KINDS: [Kind; 4] = [Kind::Grip, Kind::Move, Kind::Reference, Kind::Home];

/// An alarm of a drift, which has a part.
fn drift(time: i64, gripper: &str, part_id: Option<&str>) -> Event {
    let event = AlarmEvent {
        event: AlarmStep::Raised,
        alarm_id: AlarmId::generate(),
        alarm: AlarmKind::DriftWarning,
        priority: AlarmKind::DriftWarning.priority(),
        gateway: None,
        count: 1,
        cause: AlarmCause { part_id: part_id.and_then(PartId::new), ..AlarmCause::default() },
    };
    Event::new(at(time), Some(name(gripper)), Detail::Alarm(Box::new(event)))
}

/// Fills a journal with events and grip records, and returns their values.
fn fill(store: &mut Store, count: u32) -> (Vec<Known<EventKind>>, Vec<Known<Kind>>) {
    let mut random = SmallRng::seed_from_u64(1);
    let (mut events, mut grips, mut rows) = (Vec::new(), Vec::new(), Vec::new());
    let (mut event_end, mut grip_end, mut time) = (Tip::default(), Tip::default(), 1_000_000);
    for number in 0..count {
        let at = tick(&mut random, &mut time);
        let gripper = *["left", "right", "rare"]
            .choose_weighted(&mut random, |name| if *name == "rare" { 1 } else { 20 })
            .unwrap();
        let part = Some(if number % 2 == 0 { "P-1" } else { "P-2" }).filter(|_| random.random_range(0..3) == 0);
        let outcome = *[Outcome::PartHeld, Outcome::NoPart].choose(&mut random).unwrap();
        let event = match random.random_range(0..5) {
            _ if random.random_range(0..100) == 0 => drift(at, gripper, part),
            0 => link(at, gripper),
            1 => started(at),
            2 => admitted(at, gripper, number, part),
            _ => done(at, gripper, number, part, outcome),
        };
        let row = Row::event(event_end, &event).unwrap();
        let stored = row.event.clone().unwrap();
        events.push(Known {
            seq: row.tip.seq,
            at,
            gripper: stored.gripper.clone(),
            kind: stored.kind,
            part_id: stored.part_id.clone(),
            outcome: stored.outcome,
        });
        event_end = row.tip;
        rows.push(row);
        if number % 3 == 0 {
            let other = if part.is_some() { Kind::Reference } else { Kind::Move };
            let kind = if random.random_range(0..20) == 0 { other } else { Kind::Grip };
            let record = GripRecord { kind, outcome, curve: Vec::new(), ..grip(at, gripper, number, part) };
            let row = Row::grip(grip_end, &record).unwrap();
            grips.push(Known {
                seq: row.tip.seq,
                at,
                gripper: Some(record.gripper),
                kind,
                part_id: record.part_id,
                outcome: Some(outcome),
            });
            grip_end = row.tip;
            rows.push(row);
        }
    }
    store.commit(&rows, &PersistedValues::new()).unwrap();
    (events, grips)
}

/// Returns all combinations of filters, each with values that occur and values that don't.
fn filters<K: ChainKind>(kinds: &[K]) -> Vec<Filter<K>> {
    let kinds: Vec<_> = std::iter::once(None).chain(kinds.iter().copied().map(Some)).collect();
    let mut filters = Vec::new();
    for gripper in [None, Some("left"), Some("rare"), Some("none")] {
        for &kind in &kinds {
            for (part_id, part_prefix) in
                [(None, None), (Some("P-1"), None), (Some("none"), None), (None, Some("P-")), (None, Some("p"))]
            {
                for outcome in [None, Some(Outcome::PartHeld), Some(Outcome::Blocked)] {
                    let gripper = gripper.map(name);
                    let [part_id, part_prefix] = [part_id, part_prefix].map(|part| part.and_then(PartId::new));
                    filters.push(Filter { gripper, kind, part_id, part_prefix, outcome, command_id: None });
                }
            }
        }
    }
    filters
}

fn compare<K: ChainKind + std::fmt::Debug>(store: &Store, known: &[Known<K>], kinds: &[K]) {
    let times: Vec<_> = known.iter().map(|known| known.at).collect();
    let (first, last) = (*times.iter().min().unwrap(), *times.iter().max().unwrap());
    let ranges = [
        (None, None),
        (Some(first + (last - first) / 3), Some(first + (last - first) / 2)),
        (Some(last - 60), None),
        (None, Some(first)),
        (Some(last / 2), Some(last / 2)),
    ];
    for (i, filter) in filters(kinds).into_iter().enumerate() {
        for (from, to) in ranges {
            let order = if i % 2 == 0 { Order::Newest } else { Order::Oldest };
            let limit = Limit::new(if i % 3 == 0 { 1000 } else { 173 }).unwrap();
            let query =
                Query { filter: filter.clone(), from: from.map(at), to: to.map(at), limit, cursor: None, order };
            assert_eq!(paged(store, query.clone()), expected(known, &query), "{query:?}");
        }
    }
}

#[test]
fn pages_match_a_scan_of_all_records() {
    let mut store = Store::open(JournalLocation::Memory).unwrap();
    let (events, grips) = fill(&mut store, 6000);
    compare(&store, &events, &EVENT_KINDS);
    compare(&store, &grips, &GRIP_KINDS);
}

#[test]
fn page_of_a_large_journal_is_fast() {
    let mut store = Store::open(JournalLocation::Memory).unwrap();
    let (events, grips) = fill(&mut store, 60_000);
    slowest(&store, &events, &EVENT_KINDS);
    slowest(&store, &grips, &GRIP_KINDS);
}

/// Returns the time that this thread has run, without the turns of other threads.
fn processor_time() -> Duration {
    clock_gettime(ClockId::ThreadCPUTime).try_into().unwrap()
}

fn slowest<K: ChainKind + std::fmt::Debug>(store: &Store, known: &[Known<K>], kinds: &[K]) {
    let (old, new) = (known[known.len() / 100].at, known[known.len() / 2].at);
    // A prefix has no index of its own, so its pages take the longer the more of its parts there are.
    for filter in filters(kinds).into_iter().filter(|filter| filter.part_prefix.is_none()) {
        for (from, to) in [(None, None), (Some(old), Some(old + 500)), (Some(old), Some(new)), (Some(0), Some(1))] {
            for order in [Order::Newest, Order::Oldest] {
                let query =
                    Query { filter: filter.clone(), from: from.map(at), to: to.map(at), order, ..Query::default() };
                // The fastest of three, because other threads take room in the caches.
                let time = (0..3).map(|_| {
                    let start = processor_time();
                    page(&store.connection, &query, i64::MAX).unwrap();
                    processor_time().checked_sub(start).unwrap()
                });
                let time = time.min().unwrap();
                assert!(time < Duration::from_millis(20), "{time:?}: {query:?}");
            }
        }
    }
}

#[test]
fn invalid_limits_and_cursors_name_the_remedy() {
    assert_eq!(
        Limit::new(0).unwrap_err().to_string(),
        "limit is 0; it must be from 1 to 1000: use the cursor to get more records"
    );
    assert!(Limit::new(1001).is_err() && Limit::new(u64::MAX).is_err());
    assert!("x".parse::<Cursor>().unwrap_err().to_string().contains("next_cursor"));
    let mut store = Store::open(JournalLocation::Memory).unwrap();
    fill(&mut store, 10);
    for cursor in ["-9223372036854775808", "9223372036854775807", "0"] {
        for order in [Order::Newest, Order::Oldest] {
            let query = EventQuery { cursor: Some(cursor.parse().unwrap()), order, ..EventQuery::default() };
            page(&store.connection, &query, i64::MAX).unwrap();
        }
    }
    assert_eq!(store.end(Chain::Events).unwrap().seq, 10);
}
