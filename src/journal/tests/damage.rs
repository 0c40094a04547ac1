//! Journals with pages damaged before the start.

use std::fs;
use std::os::unix::fs::FileExt as _;

use super::*;
use crate::journal::source::Source;
use crate::journal::verify::verify_in_parts;

/// Number of records: more than the check at the start reads.
const MANY: u32 = 3000;

/// Closes a journal of many records, and damages the body of the record with this time.
async fn damaged(directory: &Directory, time: i64) {
    let (journal, _) = directory.open();
    for number in 0..MANY {
        record(&journal, link(number.into(), "left"));
    }
    journal.close().await.unwrap();
    drop(journal);
    let file = fs::read(directory.journal()).unwrap();
    let text = format!("{:.3}", at(time));
    let places = file.windows(text.len()).enumerate().filter(|(_, bytes)| *bytes == text.as_bytes());
    let written = fs::File::options().write(true).open(directory.journal()).unwrap();
    let mut count = 0;
    for (place, _) in places {
        written.write_all_at(b"2", place as u64).unwrap();
        count += 1;
    }
    assert!(count > 0, "{text} is in the file");
}

#[tokio::test]
async fn damage_of_the_newest_records_is_reported_at_the_start() {
    let directory = Directory::new();
    damaged(&directory, i64::from(MANY) - 10).await;
    let (journal, _) = directory.open();
    let health = journal.health().borrow().clone();
    let said = health.damage.expect("damage is reported before the first write");
    assert!(said.contains(&format!("events {}: ", MANY - 9)) && said.contains("journal verify --journal"), "{said}");
    keep(&journal, started(1)).await;
}

#[tokio::test]
async fn damage_of_old_records_is_found_in_the_background() {
    let directory = Directory::new();
    damaged(&directory, 17).await;
    let (journal, _) = directory.open();
    let mut health = journal.health();
    let found = health.wait_for(|health| health.damage.is_some());
    let found = tokio::time::timeout(Duration::from_secs(20), found).await.expect("damage is found").unwrap();
    let said = found.damage.clone().unwrap();
    assert!(said.contains("events 18: "), "{said}");
    assert_eq!(found.failure, None);
}

#[tokio::test]
async fn damage_of_an_index_is_found_in_the_background() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    for number in 0..MANY {
        record(&journal, link(number.into(), "left"));
    }
    journal.close().await.unwrap();
    drop(journal);
    let disk = rusqlite::Connection::open(directory.journal()).unwrap();
    let root: i64 = disk
        .query_row("SELECT rootpage FROM sqlite_schema WHERE name = 'events_gripper_kind'", [], |row| row.get(0))
        .unwrap();
    drop(disk);
    let file = fs::File::options().write(true).open(directory.journal()).unwrap();
    file.write_all_at(&[0xAA; 512], root as u64 * 4096 - 512).unwrap();
    let (journal, _) = directory.open();
    let mut health = journal.health();
    let found = health.wait_for(|health| health.damage.is_some());
    tokio::time::timeout(Duration::from_secs(20), found).await.expect("damage is found").unwrap();
}

#[tokio::test]
async fn check_of_a_journal_that_is_written_and_pruned_finds_nothing() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    for number in 0..20_000 {
        record(&journal, admitted(number.into(), "left", number, None));
        record(&journal, done(number.into(), "left", number, None, Outcome::Success));
        if number % 1000 == 0 {
            keep(&journal, started(1)).await;
        }
    }
    journal.close().await.unwrap();
    drop(journal);
    let retention = Retention { max_bytes: Some(4 << 20), ..Retention::default() };
    let (journal, _) = Journal::open(directory.place(), retention).unwrap();
    let reader = Reader::connect(&Source::new(directory.place())).unwrap();
    // Without rests, so that it ends soon.
    let check = std::thread::spawn(move || verify_in_parts(&reader, |_| true));
    for number in 20_000.. {
        record(&journal, admitted(number.into(), "left", number, None));
        record(&journal, done(number.into(), "left", number, None, Outcome::Success));
        keep(&journal, started(1)).await;
        if check.is_finished() {
            break;
        }
    }
    let report = check.join().unwrap().expect("the check has ended");
    assert_eq!(report.findings, []);
    assert_eq!(journal.health().borrow().damage, None);
}

#[tokio::test]
async fn close_ends_a_check() {
    let directory = Directory::new();
    damaged(&directory, 1900).await;
    let (journal, _) = directory.open();
    let mut health = journal.health();
    let found = health.wait_for(|health| health.damage.is_some());
    tokio::time::timeout(Duration::from_secs(20), found).await.expect("a whole check finds the damage").unwrap();
    journal.close().await.unwrap();
    drop(journal);
    // On a busy machine, a check can be over before the close begins.
    for _ in 0..20 {
        let (journal, _) = directory.open();
        let health = journal.health();
        journal.close().await.unwrap();
        if health.borrow().damage.is_none() {
            return;
        }
    }
    panic!("close waits for whole checks");
}
