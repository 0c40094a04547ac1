//! Removal of old records.

use super::*;

/// Closes a journal, and opens it again with this retention.
async fn reopened(directory: &Directory, journal: Journal, retention: Retention) -> Journal {
    journal.close().await.unwrap();
    drop(journal);
    Journal::open(directory.place(), retention).unwrap().0
}

/// Waits for a `pruned` event that meets a condition.
async fn pruned(journal: &Journal, up_to: impl Fn(&serde_json::Value) -> bool) -> serde_json::Value {
    let mut follow = journal.follow(Some(0), Filter { kind: Some(EventKind::Gateway), ..Filter::default() });
    loop {
        let event = match follow.next().await.unwrap().unwrap() {
            StreamItem::Event(event) => event,
            StreamItem::Removed { .. } => continue,
        };
        let event: serde_json::Value = serde_json::from_str(&event.body).unwrap();
        if event["event"] == "pruned" && up_to(&event) {
            return event;
        }
    }
}

/// Waits until all events up to this one are removed.
async fn removed(journal: &Journal, up_to_seq: i64) {
    while all(journal).await[0]["seq"] != up_to_seq + 1 {
        keep(journal, started(1)).await;
    }
}

fn old(number: i64) -> i64 {
    Timestamp::now().as_millisecond() - 86_400_000 + number
}

async fn fill(journal: &Journal, count: u32) {
    for number in 0..count {
        let time = old(number.into());
        record(journal, admitted(time, "left", number, None));
        journal.record(Record::Grip(Box::new(grip(time, "left", number, None))));
        keep(journal, done(time, "left", number, None, Outcome::PartHeld)).await;
    }
}

#[tokio::test]
async fn old_records_are_removed_and_the_rest_stays_proved() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    fill(&journal, 300).await;
    let before = std::fs::metadata(directory.journal()).unwrap().len();
    let now = Timestamp::now().as_millisecond();
    record(&journal, link(now, "left"));
    let retention = Retention { max_age: Some(Duration::from_hours(20)), ..Retention::default() };
    let journal = reopened(&directory, journal, retention).await;
    let event = pruned(&journal, |event| event["up_to_seq"] == 600 && event["grips_up_to_seq"] == 299).await;
    removed(&journal, 600).await;
    // A follower that resumes after a removed event gets the number of missed ones.
    let mut follow = journal.follow(Some(10), Filter { gripper: Some(name("left")), ..Filter::default() });
    assert_eq!(follow.next().await.unwrap(), Some(StreamItem::Removed { after: 10, missed: 590 }));
    for mut follow in [follow, journal.follow(Some(600), Filter::default())] {
        let next = follow.next().await.unwrap();
        assert!(matches!(&next, Some(StreamItem::Event(event)) if event.seq == 601), "{next:?}");
    }
    let mut report = verify(&directory.journal()).unwrap();
    while report.grips > 1 {
        keep(&journal, started(now)).await;
        report = verify(&directory.journal()).unwrap();
    }
    assert_eq!((report.findings, report.grips), (Vec::new(), 1));
    let events = all(&journal).await;
    assert_eq!(fields(&events[..2], &["seq", "link", "event"]), ["601 connected", "602 ended"]);
    assert_eq!(event["hash"].as_str().unwrap().len(), 64);
    journal.close().await.unwrap();
    drop(journal);
    assert!(std::fs::metadata(directory.journal()).unwrap().len() < before);
    // The next run continues the sequence.
    let (journal, _) = directory.open();
    keep(&journal, link(now, "left")).await;
    assert!(journal.last_seq() > 604);
    assert_eq!(verify(&directory.journal()).unwrap().findings, []);
}

#[tokio::test]
async fn running_command_and_all_later_events_stay() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    fill(&journal, 10).await;
    record(&journal, admitted(old(11), "left", 1000, None));
    fill(&journal, 10).await;
    let retention = Retention { max_age: Some(Duration::from_hours(1)), ..Retention::default() };
    let connection = rusqlite::Connection::open(directory.journal()).unwrap();
    journal.close().await.unwrap();
    drop(journal);
    let mut store = store::Store::open(directory.place()).unwrap();
    let mut pruning = prune::Pruning::new(retention, std::time::Instant::now());
    let mut end = store.end(chain::Chain::Events).unwrap();
    let at = std::time::Instant::now();
    while pruning.due() <= at {
        end = pruning.step(&mut store, end, at).unwrap().map_or(end, |row| row.tip);
    }
    let first: i64 = connection.query_row("SELECT min(seq) FROM events", [], |row| row.get(0)).unwrap();
    assert_eq!(first, 21);
    assert_eq!(verify(&directory.journal()).unwrap().findings, []);
}

#[tokio::test]
async fn too_large_file_shrinks_and_its_sequence_continues() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    fill(&journal, 1000).await;
    let max: i64 = 600_000;
    let journal = reopened(&directory, journal, Retention { max_bytes: Some(600_000), ..Retention::default() }).await;
    pruned(&journal, |event| event["up_to_seq"].as_i64() > Some(256) && event["grips_up_to_seq"].as_i64() > Some(0))
        .await;
    let connection = rusqlite::Connection::open(directory.journal()).unwrap();
    let bytes = || connection.pragma_query_value(None, "page_count", |row| row.get::<_, i64>(0)).unwrap() * 4096;
    while bytes() > max {
        keep(&journal, link(1, "left")).await;
        assert_eq!(verify(&directory.journal()).unwrap().findings, [], "intact even during a removal");
    }
    drop(connection);
    let last = journal.last_seq();
    journal.close().await.unwrap();
    drop(journal);
    assert!(std::fs::metadata(directory.journal()).unwrap().len() <= 600_000);
    assert_eq!(verify(&directory.journal()).unwrap().findings, []);
    assert!(last > 2000);
}

#[tokio::test]
async fn unattested_removal_is_found() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    fill(&journal, 5).await;
    journal.close().await.unwrap();
    let tamper = rusqlite::Connection::open(directory.journal()).unwrap();
    tamper
        .execute_batch(
            "INSERT INTO anchors SELECT 'events', seq, hash FROM events WHERE seq = 4; DELETE FROM events WHERE seq <= 4",
        )
        .unwrap();
    let findings = verify(&directory.journal()).unwrap().findings;
    let found: Vec<_> = findings.iter().map(|finding| finding.record.as_str()).collect();
    assert_eq!(found, ["anchors events"]);
    tamper.execute_batch("DELETE FROM events WHERE seq IN (7, 8)").unwrap();
    let findings = verify(&directory.journal()).unwrap().findings;
    assert!(
        findings.iter().any(|finding| finding.to_string() == "events 7: missing; the next record found is 9"),
        "{findings:?}"
    );
}

#[tokio::test]
async fn file_that_cannot_shrink_still_takes_records() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    fill(&journal, 300).await;
    journal.close().await.unwrap();
    drop(journal);
    // Without the content of its second page, SQLite cannot move any page of the file.
    let file = std::fs::File::options().write(true).open(directory.journal()).unwrap();
    std::os::unix::fs::FileExt::write_all_at(&file, &[0; 4096], 4096).unwrap();
    let retention = Retention { max_age: Some(Duration::from_hours(20)), ..Retention::default() };
    let (journal, _) = Journal::open(directory.place(), retention).unwrap();
    removed(&journal, 600).await;
    // The background check may already have found the damage.
    let health = journal.health().borrow().clone();
    assert_eq!((health.failure, health.lost), (None, 0));
}

#[tokio::test]
async fn removal_of_many_records_is_one_event() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    fill(&journal, 600).await;
    let retention = Retention { max_age: Some(Duration::from_hours(20)), ..Retention::default() };
    let journal = reopened(&directory, journal, retention).await;
    removed(&journal, 1200).await;
    let events = fields(&all(&journal).await, &["event"]);
    assert_eq!(events.iter().filter(|event| *event == "pruned").count(), 1, "{events:?}");
}

#[tokio::test]
async fn records_from_the_future_do_not_keep_old_ones() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    let ahead = Timestamp::now().as_millisecond() + 86_400_000;
    record(&journal, link(ahead, "left"));
    fill(&journal, 10).await;
    record(&journal, link(ahead, "left"));
    fill(&journal, 10).await;
    record(&journal, started(Timestamp::now().as_millisecond()));
    let retention = Retention { max_age: Some(Duration::from_hours(20)), ..Retention::default() };
    let journal = reopened(&directory, journal, retention).await;
    let event = pruned(&journal, |_| true).await;
    assert_eq!((event["up_to_seq"].as_i64(), event["grips_up_to_seq"].as_i64()), (Some(42), Some(19)));
    removed(&journal, 42).await;
    assert_eq!(verify(&directory.journal()).unwrap().findings, []);
}

#[tokio::test]
async fn file_stays_within_its_limit_during_fast_writes() {
    let directory = Directory::new();
    let max = 3_000_000;
    let (journal, _) =
        Journal::open(directory.place(), Retention { max_bytes: Some(max), ..Retention::default() }).unwrap();
    let connection = rusqlite::Connection::open(directory.journal()).unwrap();
    let mut largest = 0;
    for number in 0..20 {
        for _ in 0..1000 {
            record(&journal, done(number, "left", 1, None, Outcome::PartHeld));
        }
        keep(&journal, started(number)).await;
        let pages: u64 = connection.pragma_query_value(None, "page_count", |row| row.get::<_, u32>(0)).unwrap().into();
        largest = largest.max(pages * 4096);
    }
    assert!(journal.last_seq() > 20_000);
    // Some batches of 2 MB come before the first step. Without removal the file would exceed 30 MB.
    assert!(largest < max + 7_000_000, "{largest} bytes, but {max} are allowed");
}
