//! The tables of a journal file. Each value is stored once, in the body: filters use columns that SQLite derives from
//! the body, and that exist only in the indexes.

use rusqlite::Connection;

use super::kept_events;
use super::reading::statistics;

/// Marks the file as a journal of this gateway: `WSGJ`.
pub(super) const APPLICATION_ID: i32 = 0x5753_474A;

/// Version of the journal's format.
pub const VERSION: i32 = 1;

/// SQL that creates the tables. `at` (in ms since 1970) is stored in both chains, because time ranges compare it row by
/// row.
///
/// Each combination of filters has an index, to which SQLite adds the sequence number, so that no page reads more than
/// it returns; for a prefix of a part, it reads the index's entries of all its parts; for a part's alarms or reference
/// grips, it reads all records of that kind. Among events, only commands have an outcome, and only commands and alarms
/// have a part.
///
/// `spans` has the earliest and the latest `at` of each 1024 records: wall clocks jump, sequence numbers don't.
/// `running` has the commands that were admitted and have not ended. `anchors` has each chain's last removed record.
pub(super) const TABLES: &str = "
CREATE TABLE events(
    seq INTEGER PRIMARY KEY, at INTEGER NOT NULL, body TEXT NOT NULL, curve BLOB, hash BLOB NOT NULL,
    gripper TEXT AS (body ->> '$.gripper'),
    kind TEXT AS (body ->> '$.kind'),
    part_id TEXT AS (body ->> '$.part_id'),
    outcome TEXT AS (body ->> '$.outcome'),
    command_id TEXT AS (body ->> '$.command_id')
) STRICT;
CREATE INDEX events_gripper ON events(gripper);
CREATE INDEX events_kind ON events(kind);
CREATE INDEX events_gripper_kind ON events(gripper, kind);
CREATE INDEX events_outcome ON events(outcome) WHERE outcome IS NOT NULL;
CREATE INDEX events_gripper_outcome ON events(gripper, outcome) WHERE outcome IS NOT NULL;
CREATE INDEX events_part_id ON events(part_id) WHERE part_id IS NOT NULL;
CREATE INDEX events_gripper_part_id ON events(gripper, part_id) WHERE part_id IS NOT NULL;
CREATE INDEX events_part_id_outcome ON events(part_id, outcome) WHERE part_id IS NOT NULL;
CREATE INDEX events_gripper_part_id_outcome ON events(gripper, part_id, outcome) WHERE part_id IS NOT NULL;
CREATE INDEX events_command_id ON events(command_id) WHERE command_id IS NOT NULL;

CREATE TABLE grips(
    seq INTEGER PRIMARY KEY, at INTEGER NOT NULL, body TEXT NOT NULL, curve BLOB, hash BLOB NOT NULL,
    gripper TEXT AS (body ->> '$.gripper'),
    kind TEXT AS (body ->> '$.kind'),
    part_id TEXT AS (body ->> '$.part_id'),
    outcome TEXT AS (body ->> '$.outcome'),
    command_id TEXT AS (body ->> '$.id')
) STRICT;
CREATE INDEX grips_gripper ON grips(gripper);
CREATE INDEX grips_kind ON grips(kind);
CREATE INDEX grips_gripper_kind ON grips(gripper, kind);
CREATE INDEX grips_outcome ON grips(outcome);
CREATE INDEX grips_gripper_outcome ON grips(gripper, outcome);
CREATE INDEX grips_kind_outcome ON grips(kind, outcome);
CREATE INDEX grips_gripper_kind_outcome ON grips(gripper, kind, outcome);
CREATE INDEX grips_part_id ON grips(part_id) WHERE part_id IS NOT NULL;
CREATE INDEX grips_gripper_part_id ON grips(gripper, part_id) WHERE part_id IS NOT NULL;
CREATE INDEX grips_part_id_outcome ON grips(part_id, outcome) WHERE part_id IS NOT NULL;
CREATE INDEX grips_gripper_part_id_outcome ON grips(gripper, part_id, outcome) WHERE part_id IS NOT NULL;
CREATE INDEX grips_command_id ON grips(command_id);

CREATE TABLE memory(
    gripper TEXT NOT NULL, key TEXT NOT NULL, value TEXT NOT NULL, hash BLOB NOT NULL, PRIMARY KEY(gripper, key)
) STRICT, WITHOUT ROWID;
CREATE TABLE spans(
    chain TEXT NOT NULL, span INTEGER NOT NULL, oldest INTEGER NOT NULL, newest INTEGER NOT NULL,
    PRIMARY KEY(chain, span)
) STRICT, WITHOUT ROWID;
CREATE TABLE running(command_id TEXT NOT NULL PRIMARY KEY, seq INTEGER NOT NULL) STRICT, WITHOUT ROWID;
CREATE TABLE anchors(chain TEXT NOT NULL PRIMARY KEY, seq INTEGER NOT NULL, hash BLOB NOT NULL) STRICT, WITHOUT ROWID;
";

/// Number of bits that count the records within a span.
pub(super) const SPAN_BITS: u32 = 10;

/// Content of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Content {
    /// An empty file.
    Nothing,
    /// A journal of this version.
    Journal,
    /// A journal of another version.
    Version(i32),
    /// Another SQLite database.
    Other,
}

/// Determines the content of a file.
pub(super) fn content(connection: &Connection) -> rusqlite::Result<Content> {
    let tables: i64 = connection.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
    Ok(match (pragma(connection, "application_id")?, pragma(connection, "user_version")?, tables) {
        (0, 0, 0) => Content::Nothing,
        (APPLICATION_ID, VERSION, _) => Content::Journal,
        (APPLICATION_ID, version, _) => Content::Version(version),
        _ => Content::Other,
    })
}

fn pragma(connection: &Connection, name: &str) -> rusqlite::Result<i32> {
    connection.pragma_query_value(None, name, |row| row.get(0))
}

/// Makes an empty file a journal.
pub(super) fn create(connection: &mut Connection) -> rusqlite::Result<()> {
    let transaction = connection.transaction()?;
    transaction.execute_batch(TABLES)?;
    transaction.execute_batch(statistics::INDEX)?;
    transaction.execute_batch(kept_events::TABLE)?;
    transaction.pragma_update(None, "user_version", VERSION)?;
    transaction.pragma_update(None, "application_id", APPLICATION_ID)?;
    transaction.commit()
}
