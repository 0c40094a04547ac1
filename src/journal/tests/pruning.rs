//! Retention.

use super::*;

/// Closes the journal, and opens it with this retention.
async fn reopened(directory: &Directory, journal: Journal, retention: Retention) -> Journal {
    journal.close().await.unwrap();
    drop(journal);
    Journal::open(directory.place(), retention).unwrap().0
}

/// Waits for the event that attests removals up to there.
async fn pruned(journal: &Journal, up_to: impl Fn(&serde_json::Value) -> bool) -> serde_json::Value {
    let mut follow = journal.follow(Some(0), Filter { kind: Some(EventKind::Gateway), ..Filter::default() });
    loop {
        let event: serde_json::Value = serde_json::from_str(&follow.next().await.unwrap().unwrap().body).unwrap();
        if event["event"] == "pruned" && up_to(&event) {
            return event;
        }
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
        assert!(kept(journal, done(time, "left", number, None, Outcome::PartHeld)).await);
    }
}

#[tokio::test]
async fn what_is_too_old_goes_and_what_is_left_is_proved() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    fill(&journal, 300).await;
    let before = std::fs::metadata(directory.journal()).unwrap().len();
    let now = Timestamp::now().as_millisecond();
    record(&journal, link(now, "left"));
    let retention = Retention { max_age: Some(Duration::from_hours(20)), ..Retention::default() };
    let journal = reopened(&directory, journal, retention).await;
    let event = pruned(&journal, |event| event["up_to_seq"] == 600 && event["grips_up_to_seq"] == 299).await;
    assert!(kept(&journal, link(now, "left")).await);
    let report = verify(&directory.journal()).unwrap();
    assert_eq!((report.findings, report.grips), (Vec::new(), 1));
    let events = all(&journal).await;
    assert_eq!(fields(&events[..2], &["seq", "link", "event"]), ["601 connected", "602 ended"]);
    assert_eq!(event["hash"].as_str().unwrap().len(), 64);
    journal.close().await.unwrap();
    drop(journal);
    assert!(std::fs::metadata(directory.journal()).unwrap().len() < before);
    // The next run goes on behind what there was.
    let (journal, _) = directory.open();
    assert!(kept(&journal, link(now, "left")).await);
    assert!(journal.last_seq() > 604);
    assert_eq!(verify(&directory.journal()).unwrap().findings, []);
}

#[tokio::test]
async fn a_command_that_has_not_ended_stays_with_all_behind_it() {
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
    while let Some(row) = pruning.step(&mut store, end, std::time::Instant::now()).unwrap() {
        end = row.tip;
    }
    let first: i64 = connection.query_row("SELECT min(seq) FROM events", [], |row| row.get(0)).unwrap();
    assert_eq!(first, 21);
    assert_eq!(verify(&directory.journal()).unwrap().findings, []);
}

#[tokio::test]
async fn a_file_that_is_too_large_shrinks_and_its_sequence_goes_on() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    fill(&journal, 1000).await;
    let max = 600_000;
    let journal = reopened(&directory, journal, Retention { max_bytes: Some(max), ..Retention::default() }).await;
    pruned(&journal, |event| event["up_to_seq"].as_i64() > Some(256) && event["grips_up_to_seq"].as_i64() > Some(0))
        .await;
    let mut previous = u64::MAX;
    // Until a step has found nothing more to do, which it does between two commits.
    loop {
        assert!(kept(&journal, link(1, "left")).await);
        let report = verify(&directory.journal()).unwrap();
        assert_eq!(report.findings, []);
        if report.events >= previous {
            break;
        }
        previous = report.events;
    }
    let last = journal.last_seq();
    journal.close().await.unwrap();
    drop(journal);
    assert!(std::fs::metadata(directory.journal()).unwrap().len() <= max);
    assert_eq!(verify(&directory.journal()).unwrap().findings, []);
    assert!(last > 2000);
}

#[tokio::test]
async fn a_removal_that_the_events_do_not_attest_is_found() {
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
    assert!(findings.iter().any(|finding| finding.to_string() == "events 7: missing, up to 8"), "{findings:?}");
}

#[tokio::test]
async fn a_file_that_can_not_be_made_smaller_is_written_on() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    fill(&journal, 300).await;
    journal.close().await.unwrap();
    drop(journal);
    // Without what its second page says, no page of the file can be moved to another's place.
    let file = std::fs::File::options().write(true).open(directory.journal()).unwrap();
    std::os::unix::fs::FileExt::write_all_at(&file, &[0; 4096], 4096).unwrap();
    let retention = Retention { max_age: Some(Duration::from_hours(20)), ..Retention::default() };
    let (journal, _) = Journal::open(directory.place(), retention).unwrap();
    pruned(&journal, |event| event["up_to_seq"] == 600 && event["grips_up_to_seq"] == 299).await;
    assert!(kept(&journal, link(1, "left")).await);
    assert_eq!(*journal.health().borrow(), Health::default());
}
