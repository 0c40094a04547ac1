//! Events that stay when others are removed for the file's size.

use rusqlite::Connection;

use super::*;
use crate::model::{Client, FastStopCause, FastStopEvent, FastStopStep, RefusedEvent};

/// Size limit of the journals here, in bytes. Each share is a twentieth.
const MAX_BYTES: u64 = 600_000;

fn fast_stop(number: u32) -> Event {
    let fast_stop_id = IdSource::new(number.into()).fast_stop_id(at(1));
    let reason = format!("the morning's FAST STOP {number}");
    let event = FastStopStep::Latched;
    let detail = FastStopEvent { event, fast_stop_id, cause: FastStopCause::Requested, reason, count: 1 };
    Event::new(now(), Some(name("left")), Detail::FastStop(detail)).by(&client(number))
}

fn refused(number: u32) -> Event {
    let detail = RefusedEvent { command: "move".into(), code: "fast_stop".into(), cause: number.to_string(), count: 1 };
    Event::new(now(), Some(name("left")), Detail::Refused(detail)).by(&client(number))
}

/// A client of its own for each number, so that no rate is exceeded.
fn client(number: u32) -> Client {
    Client::new(format!("http:10.0.{}.{}", number / 256, number % 256), Door::Http)
}

fn now() -> Timestamp {
    row::now()
}

/// Records motions until a removal for the size has ended, `removals` times.
async fn push_out(journal: &Journal, removals: usize) {
    let mut ended = 0;
    let mut seen = 0;
    for number in 0.. {
        let time = now().as_millisecond();
        record(journal, admitted(time, "left", number, None));
        journal.record(Record::Grip(Box::new(grip(time, "left", number, None))));
        record(journal, done(time, "left", number, None, Outcome::PartHeld));
        if number % 100 == 0 {
            keep(journal, link(time, "left")).await;
            let filter = Filter { kind: Some(EventKind::Gateway), ..Filter::default() };
            let page = journal.events(EventQuery { filter, ..EventQuery::default() }).await.unwrap();
            // A later removal can remove the event of an earlier one.
            let newest = page.bodies.iter().find(|body| body.contains(r#""event":"kept""#));
            let newest = newest.map(|body| Stored::of(body.clone()).unwrap().seq);
            if newest.is_some_and(|newest| newest > seen) {
                seen = newest.unwrap_or_default();
                ended += 1;
            }
            if ended >= removals {
                return;
            }
        }
    }
}

async fn of_kind(journal: &Journal, kind: EventKind) -> Vec<String> {
    let filter = Filter { kind: Some(kind), ..Filter::default() };
    let query = EventQuery { filter, order: Order::Oldest, limit: Limit::new(1000).unwrap(), ..EventQuery::default() };
    journal.events(query).await.unwrap().bodies.iter().map(ToString::to_string).collect()
}

fn open(directory: &Directory) -> Journal {
    Journal::open(directory.place(), Retention { max_bytes: Some(MAX_BYTES), ..Retention::default() }).unwrap().0
}

/// A closed journal from which records were removed, with two FAST STOPs and two refusals from before.
async fn pushed_out() -> Directory {
    let directory = Directory::new();
    let journal = open(&directory);
    for event in [fast_stop(1), refused(1), fast_stop(2), refused(2)] {
        keep(&journal, event).await;
    }
    push_out(&journal, 1).await;
    journal.close().await.unwrap();
    directory
}

#[tokio::test]
async fn fast_stops_and_refusals_outlive_a_flood_of_motions() {
    let directory = Directory::new();
    let journal = open(&directory);
    let before = now();
    for event in [fast_stop(1), refused(1), fast_stop(2), refused(2)] {
        keep(&journal, event).await;
    }
    push_out(&journal, 2).await;
    let stops = of_kind(&journal, EventKind::FastStop).await;
    assert_eq!(stops.len(), 2, "{stops:?}");
    assert!(stops[0].contains("FAST STOP 1") && stops[1].contains("FAST STOP 2"));
    assert_eq!(of_kind(&journal, EventKind::Refused).await.len(), 2);
    let report = verify(&directory.journal()).unwrap();
    assert_eq!(report.findings, []);
    // A list by time finds them, and a follower gets them after a notice of the removed events.
    let in_time = EventQuery { from: Some(before), order: Order::Oldest, ..EventQuery::default() };
    assert!(journal.events(in_time).await.unwrap().bodies[0].contains("FAST STOP 1"));
    let mut follow = journal.follow(Some(0), Filter::default());
    let anchor = anchor_of(&directory);
    assert_eq!(follow.next().await.unwrap(), Some(StreamItem::Removed { after: 0, missed: anchor - 4 }));
    for seq in [1, 2, 3, 4, anchor + 1] {
        assert_eq!(next_event(&mut follow).await.seq, seq);
    }
}

/// Returns the sequence number of the newest removed event.
fn anchor_of(directory: &Directory) -> i64 {
    let connection = Connection::open(directory.journal()).unwrap();
    connection.query_row("SELECT seq FROM anchors WHERE chain = 'events'", [], |row| row.get(0)).unwrap()
}

#[tokio::test]
async fn only_newer_events_of_a_share_push_its_oldest_out() {
    let directory = Directory::new();
    let journal = open(&directory);
    keep(&journal, fast_stop(1)).await;
    for number in 1..=200 {
        keep(&journal, refused(number)).await;
    }
    push_out(&journal, 3).await;
    let refused = of_kind(&journal, EventKind::Refused).await;
    assert!(refused.len() < 100, "{} refusals of some 600 bytes in 30,000", refused.len());
    assert!(refused.last().unwrap().contains(r#""cause":"200""#));
    assert_eq!(of_kind(&journal, EventKind::FastStop).await.len(), 1, "the other share is not affected");
    assert_eq!(verify(&directory.journal()).unwrap().findings, []);
}

#[tokio::test]
async fn removal_by_age_removes_kept_events_too() {
    let directory = pushed_out().await;
    let connection = Connection::open(directory.journal()).unwrap();
    let newest: i64 = connection.query_row("SELECT max(seq) FROM events", [], |row| row.get(0)).unwrap();
    drop(connection);
    let retention = Retention { max_age: Some(Duration::from_millis(1)), ..Retention::default() };
    let mut store = store::Store::open(directory.place()).unwrap();
    let mut pruning = prune::Pruning::new(retention, Instant::now());
    let later = now() + jiff::SignedDuration::from_hours(2);
    let mut end = store.end(chain::Chain::Events).unwrap();
    let mut steps = 0;
    while store.connection.query_row("SELECT count(*) FROM kept", [], |row| row.get::<_, i64>(0)).unwrap() > 0 {
        end = pruning.step_at(&mut store, end, Instant::now(), later).unwrap().map_or(end, |row| row.tip);
        steps += 1;
        assert!(steps < 10_000, "kept events stay");
    }
    let left: i64 = store.connection.query_row("SELECT min(seq) FROM events", [], |row| row.get(0)).unwrap();
    assert!(left > 4, "{left} is left of {newest}");
}

#[tokio::test]
async fn kept_events_are_removed_when_they_get_too_old() {
    let directory = pushed_out().await;
    let mut store = store::Store::open(directory.place()).unwrap();
    let days = 24 * 3_600_000;
    let older = format!("UPDATE events SET at = at - 3 * {days} WHERE seq IN (SELECT seq FROM kept)");
    store.connection.execute_batch(&older).unwrap();
    let retention = Retention { max_age: Some(Duration::from_hours(24)), ..Retention::default() };
    let mut pruning = prune::Pruning::new(retention, Instant::now());
    let mut end = store.end(chain::Chain::Events).unwrap();
    for _ in 0..10 {
        end = pruning.step_at(&mut store, end, Instant::now(), now()).unwrap().map_or(end, |row| row.tip);
    }
    let kept = "SELECT count(*) FROM kept";
    assert_eq!(store.connection.query_row(kept, [], |row| row.get::<_, i64>(0)).unwrap(), 0);
    let left = "SELECT count(*) FROM events WHERE seq > (SELECT seq FROM anchors WHERE chain = 'events')";
    assert!(store.connection.query_row(left, [], |row| row.get::<_, i64>(0)).unwrap() > 0, "newer events stay");
}

#[tokio::test]
async fn change_of_a_kept_event_is_found() {
    let changes = [
        ("UPDATE events SET body = replace(body, 'FAST STOP 1', 'FAST STOP 7') WHERE kind = 'fast_stop'", "events 1"),
        ("DELETE FROM events WHERE kind = 'fast_stop' AND seq = 1", "events 1"),
        ("DELETE FROM kept WHERE seq = 1", "events 1"),
        ("DELETE FROM kept WHERE seq = 1; DELETE FROM events WHERE seq = 1", "kept fast_stops 3"),
        ("DELETE FROM kept WHERE share = 'fast_stops'; DELETE FROM events WHERE kind = 'fast_stop'", "kept fast_stops"),
        (
            "INSERT OR REPLACE INTO anchors SELECT 'kept fast_stops', seq, link FROM kept WHERE seq = 1;
             DELETE FROM kept WHERE seq = 1; DELETE FROM events WHERE seq = 1",
            "kept fast_stops",
        ),
        ("UPDATE events SET at = at + 1 WHERE seq = 1", "events 1"),
    ];
    let original = pushed_out().await;
    for (sql, expected) in changes {
        let directory = Directory::new();
        std::fs::copy(original.journal(), directory.journal()).unwrap();
        assert_eq!(verify(&directory.journal()).unwrap().findings, []);
        Connection::open(directory.journal()).unwrap().execute_batch(sql).unwrap();
        let findings = verify(&directory.journal()).unwrap().findings;
        assert!(findings.iter().any(|found| found.record == expected), "{sql}: {findings:?}");
    }
}

#[tokio::test]
async fn client_that_changes_recipes_in_a_loop_is_refused_and_others_are_not() {
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    let recipes = crate::recipes::Recipes::new(name("gateway"), journal.clone(), &[]);
    let looping = Client::new("token:operator", Door::Http);
    let other = Client::new("token:mes", Door::Http);
    let mut changes = 0;
    while journal.allows_change(&looping) {
        changes += 1;
        assert!(changes < 5000, "no limit");
        let recipe = recipe(changes);
        recipes.set(vec![(recipe, crate::recipes::ExpectedVersion::Any)], &looping).unwrap();
    }
    assert!(changes > 500, "{changes}");
    assert!(journal.allows_change(&other));
}

fn recipe(number: u32) -> crate::model::Recipe {
    use crate::model::{Recipe, RecipeDescription, RecipeNumber, RecipeValues};
    Recipe {
        part_id: PartId::new("P-1").unwrap(),
        number: RecipeNumber::new(1).unwrap(),
        values: RecipeValues { width_mm: Some(f64::from(number) / 100.0), ..RecipeValues::default() },
        description: RecipeDescription::new("").unwrap(),
        grippers: std::collections::BTreeMap::new(),
    }
}
