//! The journal's id, and subscriptions to its grip records.

use super::*;
use crate::model::DeviceEvent;

#[tokio::test]
async fn journal_id_lasts_as_long_as_the_file() {
    let (directory, other) = (Directory::new(), Directory::new());
    let first = directory.open().0;
    let id = first.id();
    first.close().await.unwrap();
    drop(first);
    let (again, recovered) = directory.open();
    assert_eq!(again.id(), id);
    assert_ne!(other.open().0.id(), id);
    assert!(recovered.memory.is_empty(), "the id does not belong to a gripper");
}

#[tokio::test]
async fn restored_backup_is_another_journal() {
    let directory = Directory::new();
    let journal = directory.open().0;
    keep(&journal, started(1)).await;
    let id = journal.id();
    let copy = directory.0.join("copy.db");
    back_up(&directory.journal(), &copy, |_, _| {}).unwrap();
    journal.close().await.unwrap();
    drop(journal);
    assert_eq!(directory.open().0.id(), id, "the original keeps its id");
    assert_eq!(verify(&copy).unwrap().findings, []);
    std::fs::rename(&copy, directory.journal()).unwrap();
    assert_ne!(directory.open().0.id(), id);
}

#[tokio::test]
async fn journal_of_an_earlier_version_gets_an_id() {
    let directory = Directory::new();
    let journal = directory.open().0;
    keep(&journal, started(1)).await;
    journal.close().await.unwrap();
    drop(journal);
    let connection = rusqlite::Connection::open(directory.journal()).unwrap();
    connection.execute("DELETE FROM memory", []).unwrap();
    drop(connection);
    std::fs::remove_file(directory.0.join("journal.db-head")).unwrap();
    let journal = directory.open().0;
    let id = journal.id();
    assert_eq!(fields(&all(&journal).await, &["event"]), ["started", "ended", "restored"]);
    journal.close().await.unwrap();
    drop(journal);
    assert_eq!(directory.open().0.id(), id);
    assert_eq!(verify(&directory.journal()).unwrap().findings, []);
}

#[tokio::test]
async fn grip_is_broadcast_when_stored_and_when_its_part_is_lost() {
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    let mut grips = journal.subscribe_grips();
    let mut next = async |lost_at: &str| {
        let update = grips.recv().await.unwrap();
        assert_eq!((update.seq, &update.gripper), (1, &name("left")));
        assert!(update.body.ends_with(&format!(r#","part_lost_at":{lost_at}}}"#)), "{}", update.body);
    };
    journal.record(Record::Grip(Box::new(grip(1000, "left", 1, None))));
    next("null").await;
    let lost = Detail::Device(DeviceEvent::PartLost { width_mm: None });
    keep(&journal, Event::new(at(61_000), Some(name("left")), lost).of(id(1))).await;
    next(r#""1970-01-01T00:01:01.000Z""#).await;
}

#[tokio::test]
async fn forward_page_has_a_cursor_for_later_records() {
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    let query = EventQuery { order: Order::Oldest, ..EventQuery::default() };
    let resume = async |query: &EventQuery| journal.events(query.clone()).await.unwrap().resume_cursor;
    assert_eq!(resume(&query).await.as_deref(), Some("0"));
    for number in 1..=3 {
        keep(&journal, link(number, "left")).await;
    }
    assert_eq!(resume(&query).await.as_deref(), Some("3"));
    let later = EventQuery { cursor: Some(Cursor::after(3)), ..query.clone() };
    assert_eq!(resume(&later).await.as_deref(), Some("3"));
    // Only commands have a part, so this query reads nothing.
    let part_id = PartId::new("P-1");
    let filter = Filter { kind: Some(EventKind::Link), part_id, ..Filter::default() };
    assert_eq!(resume(&EventQuery { filter, ..later }).await.as_deref(), Some("3"));
    assert_eq!(resume(&EventQuery::default()).await, None, "the newest come first");
}
