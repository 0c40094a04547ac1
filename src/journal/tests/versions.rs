//! Journals of other versions of the gateway, and backups.

use std::fs;
use std::path::Path;

use super::*;

/// A journal of each format: `N.sql` is of format N. A new format needs a file.
const RECORDED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/recordings/journals");

/// Writes a recorded journal into a file.
fn restore(format: i32, path: &Path) {
    let sql = fs::read_to_string(format!("{RECORDED}/{format}.sql")).unwrap();
    rusqlite::Connection::open(path).unwrap().execute_batch(&sql).unwrap();
}

#[tokio::test]
async fn journal_of_each_format_opens_with_its_records_and_state() {
    for format in 1..=VERSION {
        let directory = Directory::new();
        restore(format, &directory.journal());
        assert_eq!(
            verify(&directory.journal()).map(|report| (report.events, report.grips, report.findings)),
            Ok((13, 3, vec![]))
        );
        let (journal, recovered) = directory.open();
        assert!(!recovered.unclean && recovered.running.is_empty(), "format {format}");
        let latch = recovered.memory.iter().find(|memory| memory.key == PersistedKey::Latch).unwrap();
        assert!(latch.value.as_ref().unwrap().contains("01a20533-f4dd-75cb-8f0e-c2c5c969f7b4"));
        assert_eq!(
            (journal.last_seq(), journal.id().to_string().as_str()),
            (13, "01a20533-e813-7150-b08c-f5b471b2e93e")
        );
        keep(&journal, started(1)).await;
        journal.close().await.unwrap();
        drop(journal);
        assert_eq!(verify(&directory.journal()).unwrap().findings, []);
    }
}

#[test]
fn journal_of_a_newer_format_is_refused_and_left_unchanged() {
    let directory = Directory::new();
    restore(VERSION, &directory.journal());
    let newer = VERSION + 1;
    let connection = rusqlite::Connection::open(directory.journal()).unwrap();
    connection.pragma_update(None, "user_version", newer).unwrap();
    drop(connection);
    let before = fs::read(directory.journal()).unwrap();
    let refused = [
        Journal::open(directory.place(), Retention::default()).unwrap_err().to_string(),
        Reader::open(&directory.journal()).unwrap_err().to_string(),
        back_up(&directory.journal(), &directory.0.join("copy.db"), |_, _| {}).unwrap_err().to_string(),
    ];
    for text in refused {
        assert!(text.contains(&format!("version {newer}, but this gateway needs version {VERSION}")), "{text}");
        assert!(text.contains("restore the backup from before the upgrade"), "{text}");
    }
    assert!(fs::read(directory.journal()).unwrap() == before);
}

#[tokio::test]
async fn backup_of_a_journal_in_use_is_complete() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    for number in 1..=20 {
        keep(&journal, link(number, "left")).await;
    }
    let (copy, mut copied) = (directory.0.join("copy.db"), (0, 0));
    back_up(&directory.journal(), &copy, |part, all| copied = (part, all)).unwrap();
    assert!(copied.0 == copied.1 && copied.1 == fs::metadata(&copy).unwrap().len(), "{copied:?}");
    assert_eq!(verify(&copy).map(|report| (report.events, report.findings)), Ok((20, vec![])));
    assert!(kept(&journal, link(21, "left")).await, "the gateway goes on writing");
    let existing = back_up(&directory.journal(), &copy, |_, _| {}).unwrap_err().to_string();
    assert!(existing.contains("copy.db exists: name a new file"), "{existing}");
    let nowhere = back_up(&directory.journal(), Path::new("/nowhere/copy.db"), |_, _| {}).unwrap_err().to_string();
    assert!(nowhere.contains("/nowhere/copy.db cannot be written"), "{nowhere}");
    let names: Vec<_> = fs::read_dir(&directory.0).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(
        names.iter().all(|name| !name.to_string_lossy().contains("copy.db.") && name != "copy.db-wal"),
        "{names:?}"
    );
}

#[tokio::test]
async fn journal_in_use_is_known() {
    let directory = Directory::new();
    assert_eq!(is_in_use(&directory.journal()), None);
    let (journal, _) = directory.open();
    assert_eq!(is_in_use(&directory.journal()), Some(true));
    journal.close().await.unwrap();
    drop(journal);
    assert_eq!(is_in_use(&directory.journal()), Some(false));
}
