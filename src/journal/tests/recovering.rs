//! Restarts after orderly and unclean ends.

use super::*;

#[tokio::test]
async fn orderly_end_leaves_nothing_open() {
    let directory = Directory::new();
    let (journal, recovered) = directory.open();
    assert!(!recovered.unclean && recovered.memory.is_empty());
    record(&journal, started(1));
    journal.close().await.unwrap();
    assert!(
        !directory.0.join("journal.db-wal").exists()
            || std::fs::metadata(directory.0.join("journal.db-wal")).unwrap().len() == 0
    );
    assert!(!kept(&journal, started(2)).await, "recorded after the end");
    assert_eq!(journal.health().borrow().lost, 1);
    let (journal, recovered) = directory.open();
    assert!(!recovered.unclean && recovered.running.is_empty());
    assert_eq!(fields(&all(&journal).await, &["seq", "event"]), ["1 started", "2 ended"]);
}

#[tokio::test]
async fn running_commands_end_as_unknown_after_an_unclean_end() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    for event in [
        started(1),
        admitted(2, "left", 1, Some("P-1")),
        admitted(3, "right", 2, None),
        done(4, "right", 2, None, Outcome::NoPart),
    ] {
        record(&journal, event);
    }
    drop(journal);
    let (journal, recovered) = directory.open();
    assert!(recovered.unclean);
    assert_eq!(recovered.running, [id(1)]);
    let events = all(&journal).await;
    assert_eq!(
        fields(
            &events[4..],
            &[
                "seq",
                "kind",
                "phase",
                "event",
                "gripper",
                "subject",
                "door",
                "outcome",
                "part_id",
                "started_at",
                "running"
            ]
        ),
        [
            "5 command done left http:127.0.0.1 http UNKNOWN P-1 1970-01-01T00:00:00.002Z".to_owned(),
            format!("6 gateway unclean_end null null null [\"{}\"]", id(1)),
        ]
    );
    assert_eq!(journal.command(name("left"), id(1)).await.unwrap().unwrap().outcome, Some(Outcome::Unknown));
    // At a second unclean end no command is running.
    drop(journal);
    let (journal, recovered) = directory.open();
    assert!(recovered.unclean && recovered.running.is_empty());
    assert_eq!(fields(&all(&journal).await[6..], &["seq", "event", "running"]), ["7 unclean_end []"]);
}

#[tokio::test]
async fn persisted_values_outlive_a_restart_until_they_are_deleted() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    for value in [
        memory("left", PersistedKey::Latch, Some("{\"id\":1}")),
        memory("left", PersistedKey::Lease, Some("6")),
        memory("left", PersistedKey::Lease, Some("7")),
        memory("right", PersistedKey::Settings, Some("{}")),
        memory("right", PersistedKey::Settings, None),
    ] {
        journal.record(Record::Persisted(value));
    }
    drop(journal);
    let (journal, recovered) = directory.open();
    let expected =
        [memory("left", PersistedKey::Latch, Some("{\"id\":1}")), memory("left", PersistedKey::Lease, Some("7"))];
    assert_eq!(recovered.memory, expected);
    journal.record(Record::Persisted(memory("left", PersistedKey::Latch, None)));
    journal.close().await.unwrap();
    assert_eq!(directory.open().1.memory, expected[1..]);
}

#[tokio::test]
async fn requests_keep_the_order_of_their_records_when_a_clock_is_set_back() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    let now = Timestamp::now().as_millisecond();
    for (number, ahead) in [(3, 86_400_000), (2, 86_300_000), (1, -1000)] {
        record(&journal, admitted(now + ahead, "left", number, None));
    }
    drop(journal);
    let (_, recovered) = directory.open();
    let ids: Vec<_> = recovered.requests.iter().map(|request| request.command.id).collect();
    assert_eq!(ids, [id(3), id(2), id(1)]);
}

#[tokio::test]
async fn old_requests_expire_after_the_clock_was_set_back() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    let now = Timestamp::now().as_millisecond();
    // Records of ten hours, and one after the clock was set back by them.
    for number in 0..60 {
        record(&journal, admitted(now + i64::from(number) * 600_000, "left", number, None));
    }
    record(&journal, admitted(now - 1000, "left", 60, None));
    journal.close().await.unwrap();
    drop(journal);
    let (_, recovered) = directory.open();
    let ids: Vec<_> = recovered.requests.iter().map(|request| request.command.id).collect();
    assert_eq!(ids, [id(59), id(60)]);
}

#[tokio::test]
async fn recent_requests_stand_after_the_clock_was_ahead() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    let now = Timestamp::now().as_millisecond();
    for (number, at) in [(1, now - 700_000), (2, now - 120_000), (3, now + 36_000_000), (4, now - 60_000)] {
        record(&journal, admitted(at, "left", number, None));
    }
    journal.close().await.unwrap();
    drop(journal);
    let (_, recovered) = directory.open();
    let ids: Vec<_> = recovered.requests.iter().map(|request| request.command.id).collect();
    assert_eq!(ids, [id(2), id(3), id(4)]);
}

#[tokio::test]
async fn requests_of_the_last_ten_minutes_stand_for_their_commands() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    let now = Timestamp::now().as_millisecond();
    for event in [
        admitted(now - 601_000, "left", 1, None),
        done(now - 601_000, "left", 1, None, Outcome::Success),
        admitted(now - 590_000, "left", 2, Some("P-2")),
        done(now - 589_000, "left", 2, Some("P-2"), Outcome::PartHeld),
        admitted(now - 1000, "left", 3, None),
        done(now - 999, "left", 3, None, Outcome::Refused),
        admitted(now - 500, "right", 4, None),
    ] {
        record(&journal, event);
    }
    drop(journal);
    let (_, recovered) = directory.open();
    let requests: Vec<_> = recovered
        .requests
        .iter()
        .map(|request| {
            (request.request_id.as_str(), request.command.id, request.command.outcome, request.parameters.width_mm)
        })
        .collect();
    assert_eq!(
        requests,
        [
            ("request-2", id(2), Some(Outcome::PartHeld), Some(20.5)),
            ("request-4", id(4), Some(Outcome::Unknown), Some(20.5)),
        ]
    );
    assert_eq!(recovered.requests[0].command.gripper, name("left"));
}

#[tokio::test]
async fn second_gateway_cannot_open_the_journal() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    keep(&journal, started(1)).await;
    let second = Journal::open(directory.place(), Retention::default()).unwrap_err().to_string();
    assert!(second.contains("journal.db is in use by another gateway") && second.contains("--journal"), "{second}");
    assert_eq!(Reader::open(&directory.journal()).unwrap().last_seq().unwrap(), 1);
    drop(journal);
    directory.open();
}

#[test]
fn second_gateway_cannot_open_the_journal_through_a_link() {
    use std::os::unix::fs::symlink;
    let directory = Directory::new();
    let by = |name: &str| directory.0.join(name);
    std::fs::create_dir(by("real")).unwrap();
    symlink("real", by("directory")).unwrap();
    symlink("directory/journal.db", by("link")).unwrap();
    // The first round creates the target of the link.
    for (first, second) in [("link", "real/journal.db"), ("directory/journal.db", "link"), ("real/journal.db", "link")]
    {
        let (_journal, _) = Journal::open(JournalLocation::File(by(first)), Retention::default()).unwrap();
        let refused = Journal::open(JournalLocation::File(by(second)), Retention::default()).unwrap_err();
        assert!(matches!(refused, OpenError::Locked(_)), "{refused}");
    }
    symlink("round", by("round")).unwrap();
    let refused = Journal::open(JournalLocation::File(by("round")), Retention::default()).unwrap_err().to_string();
    assert!(refused.contains("links"), "{refused}");
}

#[test]
fn other_file_is_refused_and_left_unchanged() {
    let directory = Directory::new();
    let refused = || Journal::open(directory.place(), Retention::default()).unwrap_err().to_string();
    std::fs::write(
        directory.journal(),
        "Notes that are as long as the header of a database, but have another format. ".repeat(20),
    )
    .unwrap();
    let before = std::fs::read(directory.journal()).unwrap();
    assert!(refused().contains("move the file away"), "{}", refused());
    assert_eq!(std::fs::read(directory.journal()).unwrap(), before);
    std::fs::remove_file(directory.journal()).unwrap();
    let other = rusqlite::Connection::open(directory.journal()).unwrap();
    other.execute_batch("CREATE TABLE notes(text)").unwrap();
    assert!(refused().contains("is not a journal"), "{}", refused());
    other.execute_batch("DROP TABLE notes; PRAGMA application_id = 0x5753474A; PRAGMA user_version = 7;").unwrap();
    assert!(refused().contains("has version 7, but this gateway needs version 1"), "{}", refused());
    assert!(Reader::open(&directory.journal()).unwrap_err().to_string().contains("version 7"));
    assert!(Reader::open(&directory.0.join("none.db")).unwrap_err().to_string().contains("does not exist"));
}

#[test]
fn missing_directories_are_created() {
    let directory = Directory::new();
    Journal::open(JournalLocation::File(directory.0.join("a/b/journal.db")), Retention::default()).unwrap();
    std::fs::write(directory.0.join("file"), "").unwrap();
    let place = JournalLocation::File(directory.0.join("file/journal.db"));
    let refused = Journal::open(place, Retention::default()).unwrap_err().to_string();
    assert!(refused.contains("/file for the journal") || refused.contains("/file/journal.db"), "{refused}");
}

#[tokio::test]
async fn failing_disk_at_the_start_is_reported_and_retried() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    let now = Timestamp::now().as_millisecond();
    record(&journal, admitted(now - 1000, "left", 1, None));
    journal.record(Record::Persisted(memory("left", PersistedKey::Latch, Some("1"))));
    drop(journal);
    let disk = rusqlite::Connection::open(directory.journal()).unwrap();
    disk.execute_batch("CREATE TRIGGER full BEFORE INSERT ON events BEGIN SELECT RAISE(ABORT, 'full'); END").unwrap();
    let (journal, recovered) = directory.open();
    assert_eq!((recovered.unclean, &*recovered.running), (true, &[id(1)][..]));
    assert_eq!(recovered.memory, [memory("left", PersistedKey::Latch, Some("1"))]);
    assert_eq!(recovered.requests[0].command.outcome, Some(Outcome::Unknown));
    let mut health = journal.health();
    assert!(health.borrow().failure.as_deref().is_some_and(|failure| failure.contains("full")));
    assert!(!kept(&journal, started(now)).await);
    disk.execute_batch("DROP TRIGGER full").unwrap();
    health.wait_for(|health| health.failure.is_none()).await.unwrap();
    let events = fields(&all(&journal).await, &["seq", "phase", "outcome", "event"]);
    assert_eq!(events, ["1 admitted", "2 done UNKNOWN", "3 unclean_end", "4 started"]);
    assert_eq!(journal.health().borrow().lost, 0);
}

#[tokio::test]
async fn unreadable_journal_is_reported_with_a_remedy() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    record(&journal, started(1));
    journal.close().await.unwrap();
    drop(journal);
    let whole = std::fs::metadata(directory.journal()).unwrap().len();
    std::fs::File::options().write(true).open(directory.journal()).unwrap().set_len(whole / 8192 * 4096).unwrap();
    let said = match verify(&directory.journal()) {
        Ok(report) => report.findings.iter().map(ToString::to_string).collect(),
        Err(error) => error.to_string(),
    };
    assert!(!said.is_empty() && !said.contains("journal verify"), "{said}");
    let refused =
        Journal::open(JournalLocation::File(directory.0.clone()), Retention::default()).unwrap_err().to_string();
    let unread = verify(&directory.0).unwrap_err().to_string();
    assert!(refused.contains("is a directory: name a file") && unread == refused, "{refused} {unread}");
}
