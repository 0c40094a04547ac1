//! Tests that damage a journal byte by byte.

use std::fs;
use std::os::unix::fs::FileExt;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::super::chain::Hash;
use super::super::tests::{Directory, admitted, done, grip, id, link, memory, started};
use super::super::{Record, Recorder};
use super::*;
use crate::model::{Outcome, PersistedKey};

/// Distance between damaged bytes in the whole file; coprime to 8, so that each bit has its turn.
const STRIDE: usize = 53;

/// Returns the bytes of a closed journal with all kinds of content.
fn filled(directory: &Directory) -> Vec<u8> {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let (journal, _) = directory.open();
    journal.record(Record::Event(started(1_700_000_000_000), None));
    for number in 0..6 {
        let (time, part) = (1_700_000_000_123 + i64::from(number), Some("P-1").filter(|_| number % 2 == 0));
        for event in [
            admitted(time, "left", number, part),
            done(time + 1, "left", number, part, Outcome::PartHeld),
            link(time, "left"),
        ] {
            journal.record(Record::Event(event, None));
        }
        journal.record(Record::Grip(Box::new(grip(time, "left", number, part))));
    }
    journal.record(Record::Event(admitted(1_700_000_000_999, "right", 99, None), None));
    for key in [PersistedKey::Latch, PersistedKey::Settings, PersistedKey::Lease] {
        journal.record(Record::Persisted(memory("left", key, Some("{\"remembered\":1}"))));
    }
    runtime.block_on(journal.close()).unwrap();
    // Leaves no copies of records in free space, where damage has no effect.
    let compact = "PRAGMA secure_delete = ON; VACUUM; PRAGMA wal_checkpoint(TRUNCATE)";
    Connection::open(directory.journal()).unwrap().execute_batch(compact).unwrap();
    fs::read(directory.journal()).unwrap()
}

/// Reads a column of all records, in order.
fn column<T: rusqlite::types::FromSql>(connection: &Connection, of: &str) -> Vec<T> {
    let mut statement = connection.prepare(&format!("SELECT {of} NOT INDEXED ORDER BY 1")).unwrap();
    statement.query_map([], |row| row.get(1)).unwrap().collect::<Result<_, _>>().unwrap()
}

/// Returns parts of all records' stored bytes, each with its record's name.
fn contents(path: &Path) -> Vec<(String, Vec<u8>)> {
    let connection = Connection::open(path).unwrap();
    let mut contents = Vec::new();
    for chain in Chain::ALL {
        let table = chain.name();
        let bodies =
            column::<String>(&connection, &format!("seq, body FROM {table}")).into_iter().map(String::into_bytes);
        let hashes = column::<Hash>(&connection, &format!("seq, hash FROM {table}")).into_iter().map(Vec::from);
        let named = |(i, bytes)| (format!("{table} {}", i + 1), bytes);
        contents.extend(bodies.enumerate().map(named));
        contents.extend(hashes.enumerate().map(named));
    }
    let curves = column::<Vec<u8>>(&connection, "seq, curve FROM grips");
    contents.push(("grips".to_owned(), curves[0].clone()));
    let memories = column::<Hash>(&connection, "key, hash FROM memory")
        .into_iter()
        .map(|hash| ("memory ".to_owned(), hash.to_vec()));
    contents.extend(memories);
    contents
        .push(("memory ".to_owned(), b"left".iter().chain(b"latch").chain(b"{\"remembered\":1}").copied().collect()));
    contents
}

/// Returns all places of a text in the file.
fn places(file: &[u8], text: &[u8]) -> Vec<usize> {
    (0..=file.len() - text.len()).filter(|&i| file[i] == text[0] && &file[i..i + text.len()] == text).collect()
}

fn records_of(path: &Path) -> Report {
    let reader = Reader::open(path).unwrap();
    let mut verifier = Verifier::default();
    let checked = reader.with(|connection| {
        verifier.records(connection, &mut |_| {});
        Ok(())
    });
    checked.unwrap();
    verifier.report
}

#[test]
fn intact_journal_has_no_findings_even_while_open_and_after_a_kill() {
    let directory = Directory::new();
    filled(&directory);
    let report = verify(&directory.journal()).unwrap();
    assert_eq!((report.events, report.grips, report.memories, report.findings), (21, 6, 3, Vec::new()));
    let (journal, recovered) = directory.open();
    assert_eq!(recovered.running, [id(99)]);
    journal.record(Record::Grip(Box::new(grip(1, "left", 50, None))));
    let runtime = tokio::runtime::Runtime::new().unwrap();
    assert!(runtime.block_on(super::super::tests::kept(&journal, link(2, "left"))));
    let report = verify(&directory.journal()).unwrap();
    assert_eq!((report.events, report.grips, report.findings), (23, 7, Vec::new()));
    // After a kill only the file and its write-ahead log are left.
    let killed = Directory::new();
    for end in ["", "-wal"] {
        let name = |directory: &Directory| format!("{}{end}", directory.journal().display());
        fs::copy(name(&directory), name(&killed)).unwrap();
    }
    assert_eq!(verify(&killed.journal()).unwrap().findings, []);
    assert_eq!(verify(&killed.journal()).unwrap().events, 23);
    assert!(killed.open().1.unclean);
}

/// Damages these bytes one after the other, on as many threads as there are cores, and calls `look` for each.
fn damage<T: Sync>(file: &[u8], bytes: &[(usize, T)], look: impl Fn(&Path, usize, &T) + Sync) {
    let share = bytes.len().div_ceil(std::thread::available_parallelism().map_or(1, usize::from));
    std::thread::scope(|scope| {
        for bytes in bytes.chunks(share) {
            let (directory, look) = (Directory::new(), &look);
            scope.spawn(move || {
                fs::write(directory.journal(), file).unwrap();
                let written = fs::File::options().write(true).open(directory.journal()).unwrap();
                for (i, what) in bytes {
                    written.write_all_at(&[file[*i] ^ 1 << (i % 8)], *i as u64).unwrap();
                    look(&directory.journal(), *i, what);
                    written.write_all_at(&[file[*i]], *i as u64).unwrap();
                }
            });
        }
    });
}

#[test]
fn damaged_byte_of_a_record_is_found_and_named() {
    let directory = Directory::new();
    let file = filled(&directory);
    let contents = contents(&directory.journal());
    assert_eq!(contents.len(), 21 * 2 + 6 * 2 + 1 + 5 + 1);
    let mut bytes = Vec::new();
    for (record, content) in &contents {
        let places = places(&file, content);
        assert!(!places.is_empty(), "{record}");
        bytes.extend(places.into_iter().flat_map(|begin| begin..begin + content.len()).map(|i| (i, record)));
    }
    assert!(bytes.len() > 7_000, "{}", bytes.len());
    damage(&file, &bytes, |path, i, record| {
        let report = records_of(path);
        let mut named = report.findings.iter().map(|found| &found.record);
        assert!(named.any(|named| named.starts_with(*record)), "{record}, byte {i}: {report:?}");
        let chained = |name: &&String| name.starts_with("events ") || name.starts_with("grips ");
        let named: BTreeSet<_> = report.findings.iter().map(|found| &found.record).filter(chained).collect();
        assert!(named.len() <= 1, "{record}, byte {i}: others are accused: {report:?}");
    });
}

/// Reads all records; none if that fails.
fn read(path: &Path) -> Option<Vec<Vec<Option<Vec<u8>>>>> {
    let connection = Connection::open_with_flags(path, rusqlite::OpenFlags::SQLITE_OPEN_READ_ONLY).ok()?;
    let mut all = Vec::new();
    for of in ["body, hash, curve FROM events", "body, hash, curve FROM grips", "gripper, key, value FROM memory"] {
        let mut statement = connection.prepare(&format!("SELECT {of}")).ok()?;
        let bytes = |row: &rusqlite::Row<'_>, i| {
            row.get_ref(i).map(|value| value.as_bytes_or_null().ok().flatten().map(<[u8]>::to_vec))
        };
        let rows = statement.query_map([], |row| (0..3).map(|i| bytes(row, i)).collect()).ok()?;
        all.extend(rows.collect::<Result<Vec<_>, _>>().ok()?);
    }
    Some(all)
}

#[test]
fn no_damaged_byte_changes_records_unnoticed() {
    let directory = Directory::new();
    let file = filled(&directory);
    let expected = read(&directory.journal());
    assert!(expected.is_some());
    let found = AtomicUsize::new(0);
    let bytes: Vec<_> = (0..file.len()).step_by(STRIDE).map(|i| (i, ())).collect();
    damage(&file, &bytes, |path, i, ()| {
        if verify(path).map_or(true, |report| !report.findings.is_empty()) {
            found.fetch_add(1, Ordering::Relaxed);
        } else {
            assert!(read(path) == expected, "byte {i} of {} changes what is read", file.len());
        }
    });
    let found = found.into_inner();
    assert!(found > bytes.len() / 10, "{found} of {}", bytes.len());
}
