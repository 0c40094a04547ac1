//! Journals that do not continue that of the last run, and heads.

use rusqlite::Connection;

use super::*;

/// Records three commands, each with a grip record, and closes the journal.
async fn filled(directory: &Directory) {
    let (journal, _) = directory.open();
    for number in 0..3 {
        let time = Timestamp::now().as_millisecond();
        record(&journal, admitted(time, "left", number, None));
        journal.record(Record::Grip(Box::new(grip(time, "left", number, None))));
        keep(&journal, done(time, "left", number, None, Outcome::PartHeld)).await;
    }
    journal.close().await.unwrap();
}

fn edit(directory: &Directory, sql: &str) {
    Connection::open(directory.journal()).unwrap().execute_batch(sql).unwrap();
}

/// Opens the journal, and returns why it does not continue that of the last run.
fn cause(directory: &Directory) -> Option<String> {
    let (journal, recovered) = directory.open();
    let cause = recovered.unknown_past.map(|past| past.cause().to_owned());
    assert_eq!(journal.health().borrow().restored, cause);
    cause
}

#[tokio::test]
async fn journal_that_continues_the_last_run_is_no_restored_one() {
    let directory = Directory::new();
    for _ in 0..3 {
        filled(&directory).await;
    }
    assert_eq!(cause(&directory), None);
    assert_eq!(verify(&directory.journal()).unwrap().findings, []);
}

#[tokio::test]
async fn deleted_newest_records_are_noticed_at_the_start_and_by_verification() {
    let cases = [
        ("DELETE FROM events WHERE seq > 4", "events 5 to 7: missing"),
        ("DELETE FROM grips WHERE seq > 1", "grips 2 to 3: missing"),
        ("DELETE FROM events; DELETE FROM grips", "events 1 to 7: missing"),
        ("UPDATE events SET hash = zeroblob(32) WHERE seq = 7", "events 7: another record"),
        // A forged removal of all events.
        (
            "INSERT OR REPLACE INTO anchors SELECT 'events', seq, hash FROM events WHERE seq = 7; DELETE FROM events",
            "events 7: removed",
        ),
    ];
    for (sql, expected) in cases {
        let directory = Directory::new();
        filled(&directory).await;
        edit(&directory, sql);
        let findings = verify(&directory.journal()).unwrap().findings;
        assert!(findings.iter().any(|found| found.to_string().contains(expected)), "{sql}: {findings:?}");
        let cause = cause(&directory).unwrap_or_default();
        assert!(cause.contains(expected), "{sql}: {cause}");
    }
}

#[tokio::test]
async fn empty_head_file_is_like_none_and_keeps_no_removal_secret() {
    let directory = Directory::new();
    filled(&directory).await;
    let head = Reader::open(&directory.journal()).unwrap().head().unwrap();
    let forged = "INSERT OR REPLACE INTO anchors SELECT 'events', seq + 1, hash FROM events WHERE seq = 7";
    edit(&directory, forged);
    let findings = compared(&directory, head);
    assert!(findings.iter().any(|found| found.detail.contains("cannot be compared")), "{findings:?}");
    std::fs::write(directory.0.join("journal.db-head"), "").unwrap();
    assert!(cause(&directory).unwrap().contains("is missing"));
}

#[tokio::test]
async fn missing_or_foreign_head_file_is_noticed() {
    let directory = Directory::new();
    filled(&directory).await;
    let head = directory.0.join("journal.db-head");
    let text = std::fs::read_to_string(&head).unwrap();
    std::fs::remove_file(&head).unwrap();
    assert!(cause(&directory).unwrap().contains("file of the head is missing"));
    let other = Directory::new();
    filled(&other).await;
    std::fs::write(other.0.join("journal.db-head"), text).unwrap();
    assert!(cause(&other).unwrap().contains("another journal than in the last run"));
    let damaged = Directory::new();
    filled(&damaged).await;
    std::fs::write(damaged.0.join("journal.db-head"), "?").unwrap();
    assert!(cause(&damaged).unwrap().contains("head is damaged"));
    let new = Directory::new();
    filled(&new).await;
    std::fs::remove_file(new.journal()).unwrap();
    assert!(cause(&new).unwrap().contains("another journal"), "a new file beside the head of the last one");
}

#[tokio::test]
async fn restored_backup_begins_a_new_life_until_it_is_confirmed() {
    let directory = Directory::new();
    filled(&directory).await;
    let copy = directory.0.join("copy.db");
    back_up(&directory.journal(), &copy, |_, _| {}).unwrap();
    filled(&directory).await;
    std::fs::rename(&copy, directory.journal()).unwrap();
    for _ in 0..2 {
        let (journal, recovered) = directory.open();
        let past = recovered.unknown_past.unwrap();
        assert!(past.refuses_ids(Instant::now()) && past.cause().contains("another journal"), "{}", past.cause());
        // Grippers that a reload adds know as little.
        assert!(journal.recall().await.unwrap().unknown_past.is_some());
        let events = fields(&all(&journal).await, &["event"]);
        assert_eq!(events.iter().filter(|event| *event == "restored").count(), 1, "{events:?}");
        journal.close().await.unwrap();
    }
    let (journal, recovered) = directory.open();
    journal.confirm_restored();
    assert!(!recovered.unknown_past.unwrap().refuses_ids(Instant::now()));
    assert_eq!(journal.health().borrow().restored, None);
    journal.close().await.unwrap();
    drop(journal);
    assert_eq!(cause(&directory), None);
}

fn compared(directory: &Directory, head: Head) -> Vec<Finding> {
    verify_with_progress(&directory.journal(), Some(head), |_, _| {}).unwrap().findings
}

#[tokio::test]
async fn head_from_elsewhere_shows_what_a_rewritten_journal_hides() {
    let directory = Directory::new();
    filled(&directory).await;
    let head = Reader::open(&directory.journal()).unwrap().head().unwrap();
    assert_eq!(head.to_string().parse(), Ok(head));
    assert!("7:00".parse::<Head>().unwrap_err().to_string().contains("journal head"));
    filled(&directory).await;
    assert_eq!(compared(&directory, head), [], "an older head is part of the chain");
    edit(&directory, "DELETE FROM events WHERE seq > 4; DELETE FROM memory WHERE gripper = ''");
    std::fs::remove_file(directory.0.join("journal.db-head")).unwrap();
    let findings = compared(&directory, head);
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert!(findings[0].detail.contains("events 5 to 7: missing"), "{findings:?}");
}

#[tokio::test]
async fn deleted_grips_are_found_by_the_hourly_head() {
    let directory = Directory::new();
    filled(&directory).await;
    let head = Reader::open(&directory.journal()).unwrap().head().unwrap();
    let (journal, _) = directory.open();
    keep(&journal, Event::new(row::now(), None, Detail::Gateway(head.event()))).await;
    journal.close().await.unwrap();
    assert_eq!(verify(&directory.journal()).unwrap().findings, []);
    std::fs::remove_file(directory.0.join("journal.db-head")).unwrap();
    edit(&directory, "DELETE FROM grips WHERE seq > 1");
    let findings = verify(&directory.journal()).unwrap().findings;
    assert_eq!(findings[0].to_string(), "grips 3: missing or changed, although event 8 names it");
}
