//! Jumps of the wall clock, on a virtual clock.

use super::super::tests::Directory;
use super::super::{Record, Recorder as _, Retention};
use super::*;
use crate::journal::Journal;
use crate::journal::store::Store;
use crate::model::{Detail, Event, GatewayEvent};

const YEARS: SignedDuration = SignedDuration::from_hours(4 * 365 * 24);
const MINUTE: Duration = Duration::from_mins(1);

/// A journal whose newest record is of this moment.
async fn journal_of(at: Timestamp) -> (Directory, Connection) {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    let ended = Detail::Gateway(GatewayEvent::Ended);
    journal.record(Record::Event(Event::new(at, None, ended), None));
    journal.close().await.unwrap();
    let connection = Connection::open(directory.journal()).unwrap();
    // The orderly end of the journal has another time.
    connection.execute("DELETE FROM events WHERE seq > 1", []).unwrap();
    (directory, connection)
}

#[tokio::test]
async fn clock_years_ahead_is_doubted_over_restarts_until_it_is_right() {
    let today = now();
    let (_directory, connection) = journal_of(today).await;
    let start = Instant::now();
    for _ in 0..2 {
        let mut clock = ClockCheck::new(&connection, start).unwrap();
        assert!(clock.look(&connection, today + YEARS, start, || false));
        assert!(clock.doubt().unwrap().contains("more than 30 days"));
        // Records of the wrong time do not make it plausible.
        connection.execute("UPDATE events SET at = ?", [milliseconds(today + YEARS)]).unwrap();
        assert!(clock.look(&connection, today + YEARS, start + MINUTE, || false));
    }
    let mut clock = ClockCheck::new(&connection, start).unwrap();
    assert!(!clock.look(&connection, today, start, || false));
    assert_eq!(clock.doubt(), None);
    assert_eq!(identity::value(&connection, KEY).unwrap(), None);
}

#[tokio::test]
async fn clock_that_starts_in_1970_and_is_set_right_is_not_doubted() {
    let today = now();
    let (_directory, connection) = journal_of(today).await;
    let start = Instant::now();
    let mut clock = ClockCheck::new(&connection, start).unwrap();
    assert!(!clock.look(&connection, Timestamp::UNIX_EPOCH, start, || false));
    assert!(!clock.look(&connection, today + SignedDuration::from_hours(1), start + MINUTE, || false));
}

#[tokio::test]
async fn weekend_and_slow_drift_are_not_doubted() {
    let today = now();
    let (_directory, connection) = journal_of(today).await;
    let start = Instant::now();
    let mut clock = ClockCheck::new(&connection, start).unwrap();
    assert!(!clock.look(&connection, today + SignedDuration::from_hours(20 * 24), start, || false));
    let mut wall = today;
    for minutes in 0..100 {
        wall += SignedDuration::from_hours(24);
        assert!(!clock.look(&connection, wall, start + MINUTE * minutes, || false));
    }
}

#[tokio::test]
async fn hour_with_a_time_server_or_a_person_ends_the_doubt() {
    let today = now();
    let (_directory, connection) = journal_of(today).await;
    let start = Instant::now();
    let mut clock = ClockCheck::new(&connection, start).unwrap();
    let later = today + YEARS;
    assert!(clock.look(&connection, later, start, || true));
    for minutes in 1..=60 {
        assert!(clock.look(&connection, later, start + MINUTE * minutes, || true), "{minutes}");
    }
    // A loss of the time server begins the hour again.
    assert!(clock.look(&connection, later, start + Duration::from_secs(61 * 60 - 1), || false));
    assert!(clock.look(&connection, later, start + MINUTE * 62, || true));
    assert!(clock.look(&connection, later, start + MINUTE * 121, || true));
    assert!(!clock.look(&connection, later, start + MINUTE * 122, || true));
    let mut asked = ClockCheck::new(&connection, start).unwrap();
    assert!(asked.look(&connection, later + YEARS, start, || false));
    asked.trust(&connection, later + YEARS, start);
    assert!(!asked.look(&connection, later + YEARS, start, || false));
}

#[tokio::test]
async fn start_with_a_clock_years_ahead_removes_nothing() {
    let past = now() - YEARS;
    let (directory, connection) = journal_of(past).await;
    drop(connection);
    let retention = Retention { max_age: Some(Duration::from_hours(365 * 24)), ..Retention::default() };
    let (journal, _) = Journal::open(directory.place(), retention).unwrap();
    journal.health().wait_for(|health| health.clock.is_some()).await.unwrap();
    assert_eq!(first(&directory), 1);
    journal.confirm_clock();
    journal.health().wait_for(|health| health.clock.is_none()).await.unwrap();
    journal.close().await.unwrap();
}

fn first(directory: &Directory) -> i64 {
    let store = Store::open(directory.place());
    assert!(store.is_err(), "the gateway uses it");
    let connection = Connection::open(directory.journal()).unwrap();
    connection.query_row("SELECT min(seq) FROM events", [], |row| row.get(0)).unwrap()
}
