//! Journals with files removed, replaced or truncated while they are open.

use std::fs;
use std::path::Path;

use super::*;

/// Waits until the journal reports a failure, without a record that would trigger a check.
async fn failure(journal: &Journal) -> String {
    let mut health = journal.health();
    let failed = health.wait_for(|health| health.failure.is_some());
    let failed = tokio::time::timeout(Duration::from_secs(5), failed).await.expect("the loss is noticed").unwrap();
    failed.failure.clone().unwrap()
}

/// Opens a journal and records one event. Returns the journal and its file.
async fn opened(directory: &Directory) -> (Journal, PathBuf) {
    let (journal, _) = directory.open();
    keep(&journal, started(1)).await;
    (journal, directory.journal())
}

fn beside(path: &Path, end: &str) -> PathBuf {
    PathBuf::from(format!("{}{end}", path.display()))
}

#[tokio::test]
async fn removed_journal_is_noticed_while_idle() {
    let directory = Directory::new();
    let (journal, path) = opened(&directory).await;
    fs::remove_file(&path).unwrap();
    let said = failure(&journal).await;
    assert!(said.contains("journal.db was removed") && said.contains("restart the gateway"), "{said}");
    assert!(!kept(&journal, started(2)).await);
    let closed = journal.close().await.unwrap_err().to_string();
    assert!(closed.contains("was removed"), "{closed}");
}

#[tokio::test]
async fn record_for_a_removed_journal_is_never_durable() {
    for end in ["", "-wal", "-shm"] {
        let directory = Directory::new();
        let (journal, path) = opened(&directory).await;
        fs::remove_file(beside(&path, end)).unwrap();
        assert!(!kept(&journal, started(2)).await, "{end}");
        assert!(failure(&journal).await.contains(&format!("journal.db{end} was removed")), "{end}");
    }
}

#[tokio::test]
async fn record_for_a_replaced_journal_is_never_durable() {
    let (directory, other) = (Directory::new(), Directory::new());
    let (journal, path) = opened(&directory).await;
    let (another, other) = opened(&other).await;
    another.close().await.unwrap();
    let before = fs::read(&other).unwrap();
    fs::rename(&other, &path).unwrap();
    assert!(!kept(&journal, started(2)).await);
    assert!(failure(&journal).await.contains("journal.db was replaced"));
    let _ = journal.close().await;
    assert_eq!(fs::read(&path).unwrap(), before, "the other file is left as it is");
}

#[tokio::test]
async fn truncated_journal_fails_until_a_restart() {
    for end in ["", "-wal"] {
        let directory = Directory::new();
        let (journal, path) = opened(&directory).await;
        journal.close().await.unwrap();
        drop(journal);
        let (journal, _) = opened(&directory).await;
        // The journal writes at its start, and takes the size after that as the expected one.
        assert!(kept(&journal, started(1)).await, "{end}");
        let path = beside(&path, end);
        let whole = fs::read(&path).unwrap();
        fs::File::options().write(true).open(&path).unwrap().set_len(4096).unwrap();
        assert!(!kept(&journal, started(2)).await, "{end}");
        let said = failure(&journal).await;
        assert!(said.contains(&format!("journal.db{end} was truncated from")) && said.contains("to 4096"), "{said}");
        // The file has its former size again, but another program wrote its pages.
        fs::write(&path, whole).unwrap();
        assert!(journal.close().await.unwrap_err().to_string().contains("was truncated"), "{end}");
    }
}

#[tokio::test]
async fn journal_goes_on_when_its_file_is_back() {
    let directory = Directory::new();
    let (journal, path) = opened(&directory).await;
    let away = beside(&path, "-away");
    fs::rename(&path, &away).unwrap();
    assert!(!kept(&journal, started(2)).await);
    fs::rename(&away, &path).unwrap();
    let mut health = journal.health();
    health.wait_for(|health| health.failure.is_none()).await.unwrap();
    keep(&journal, started(3)).await;
    assert_eq!(fields(&all(&journal).await, &["seq"]), ["1", "2", "3"]);
    journal.close().await.unwrap();
    assert!(verify(&path).unwrap().findings.is_empty());
}

#[tokio::test]
async fn records_before_a_lost_log_are_in_the_file() {
    let directory = Directory::new();
    let (journal, path) = opened(&directory).await;
    for number in 2..50 {
        keep(&journal, started(number)).await;
    }
    fs::remove_file(beside(&path, "-wal")).unwrap();
    failure(&journal).await;
    // A restart would find the file alone.
    let copy = Directory::new();
    fs::copy(&path, copy.journal()).unwrap();
    assert_eq!(Reader::open(&copy.journal()).unwrap().last_seq().unwrap(), 49);
}

#[tokio::test]
async fn journal_that_shrinks_by_retention_goes_on() {
    let directory = Directory::new();
    let retention = Retention { max_bytes: Some(1 << 20), ..Retention::default() };
    let (journal, _) = Journal::open(directory.place(), retention).unwrap();
    let (mut largest, mut number) = (0, 0);
    loop {
        for _ in 0..500 {
            number += 1;
            record(&journal, link(number, "left"));
        }
        keep(&journal, started(1)).await;
        let bytes = fs::metadata(directory.journal()).unwrap().len();
        if bytes < largest {
            break;
        }
        largest = bytes;
    }
    keep(&journal, started(1)).await;
}
