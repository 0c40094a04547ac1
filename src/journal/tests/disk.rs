//! Full and slow disks.

use super::*;

impl Journal {
    /// Limits the file's size, as a full disk does.
    pub(crate) fn limit_pages(&self, pages: i64) {
        self.writing.inputs.send(WriterInput::MaxPages(pages)).unwrap();
    }
}

#[tokio::test]
async fn full_disk_is_reported_and_waiting_records_are_kept() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    keep(&journal, started(1)).await;
    journal.limit_pages(1);
    let mut health = journal.health();
    let mut number = 0;
    while kept(&journal, link(number, "left")).await {
        number += 1;
    }
    let failure = health.wait_for(|health| health.failure.is_some()).await.unwrap().failure.clone().unwrap();
    assert!(failure.contains("journal.db: ") && failure.contains("full") && failure.contains("make room"), "{failure}");
    let before = journal.last_seq();
    // While the disk fails, a waiter learns of the failure at once, and the record is kept.
    assert!(!kept(&journal, link(number + 1, "left")).await);
    journal.record(Record::Persisted(memory("left", PersistedKey::Latch, Some("1"))));
    journal.limit_pages(1_000_000);
    health.wait_for(|health| health.failure.is_none()).await.unwrap();
    assert_eq!(journal.last_seq(), before + 2);
    keep(&journal, link(number + 2, "left")).await;
    journal.close().await.unwrap();
    assert_eq!(journal.health().borrow().lost, 0);
    let (_, recovered) = directory.open();
    assert_eq!((recovered.unclean, recovered.memory), (false, vec![memory("left", PersistedKey::Latch, Some("1"))]));
}

#[tokio::test]
async fn lost_records_are_counted_and_recorded() {
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    keep(&journal, started(1)).await;
    journal.limit_pages(1);
    let mut health = journal.health();
    while health.borrow().failure.is_none() {
        kept(&journal, link(1, "left")).await;
    }
    while health.borrow().lost == 0 {
        for _ in 0..100 {
            record(&journal, link(2, "left"));
        }
        tokio::task::yield_now().await;
    }
    journal.limit_pages(1_000_000);
    health.wait_for(|health| health.failure.is_none()).await.unwrap();
    let mut follow = journal.follow(Some(0), Filter { kind: Some(EventKind::Gateway), ..Filter::default() });
    let mut recorded = 0;
    while recorded < health.borrow().lost {
        let event: serde_json::Value = serde_json::from_str(&next_event(&mut follow).await.body).unwrap();
        if event["event"] == "records_lost" {
            recorded += event["count"].as_u64().unwrap();
        }
    }
    assert_eq!(recorded, health.borrow().lost);
}

#[tokio::test]
async fn close_on_a_full_disk_reports_unwritten_records() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    journal.limit_pages(1);
    while kept(&journal, link(1, "left")).await {}
    let error = journal.close().await.unwrap_err().to_string();
    assert!(error.starts_with("2 records were not written: the journal"), "{error}");
    drop(journal);
    assert!(directory.open().1.unclean);
}

/// Blocks all writes to a journal until the connection is dropped.
fn stall(directory: &Directory) -> rusqlite::Connection {
    let disk = rusqlite::Connection::open(directory.journal()).unwrap();
    disk.execute_batch("BEGIN IMMEDIATE").unwrap();
    disk
}

#[tokio::test]
async fn stalled_disk_is_reported_during_the_stall() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    let mut health = journal.health();
    let stalled = stall(&directory);
    let waiting = tokio::spawn({
        let journal = journal.clone();
        async move { kept(&journal, started(1)).await }
    });
    // The report comes long before SQLite gives up.
    let failure = health.wait_for(|health| health.failure.is_some()).await.unwrap().failure.clone().unwrap();
    assert!(failure.contains("journal.db: ") && failure.contains("within 500 ms: check the disk"), "{failure}");
    assert!(!waiting.is_finished());
    assert!(!kept(&journal, started(2)).await, "a waiter hears so at once during the stall");
    drop(stalled);
    assert!(waiting.await.unwrap());
    health.wait_for(|health| health.failure.is_none()).await.unwrap();
    keep(&journal, started(3)).await;
    assert_eq!(fields(&all(&journal).await, &["at"]).len(), 3);
    journal.close().await.unwrap();
    assert!(health.borrow().failure.as_deref().is_some_and(|failure| failure.contains("closed")));
}

#[tokio::test]
async fn full_queue_still_takes_ends_of_commands_and_persisted_values() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    keep(&journal, admitted(1, "left", 1, None)).await;
    let stalled = stall(&directory);
    while journal.health().borrow().lost == 0 {
        for _ in 0..1000 {
            record(&journal, link(2, "left"));
        }
    }
    record(&journal, done(3, "left", 1, None, Outcome::PartHeld));
    for value in ["1", "2"] {
        journal.record(Record::Persisted(memory("left", PersistedKey::Latch, Some(value))));
    }
    let lost = journal.health().borrow().lost;
    drop(stalled);
    journal.close().await.unwrap();
    assert_eq!(journal.health().borrow().lost, lost);
    drop(journal);
    let (journal, recovered) = directory.open();
    assert_eq!((recovered.unclean, recovered.memory), (false, vec![memory("left", PersistedKey::Latch, Some("2"))]));
    let command = journal.command(name("left"), id(1)).await.unwrap().unwrap();
    assert_eq!(command.outcome, Some(Outcome::PartHeld));
}

#[tokio::test]
async fn large_write_ahead_log_is_emptied_after_its_reader_has_gone() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    keep(&journal, started(1)).await;
    let reader = rusqlite::Connection::open(directory.journal()).unwrap();
    reader.execute_batch("BEGIN; SELECT count(*) FROM events;").unwrap();
    let log = || std::fs::metadata(directory.0.join("journal.db-wal")).unwrap().len();
    while log() <= 16 << 20 {
        for number in 0..500 {
            record(&journal, done(number, "left", 1, None, Outcome::PartHeld));
        }
        keep(&journal, started(2)).await;
    }
    drop(reader);
    let emptied = async {
        while log() > 16 << 20 {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(30), emptied).await.unwrap();
}
