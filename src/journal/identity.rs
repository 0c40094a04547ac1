//! The unique id of a journal, created with the journal and stored in its file. The same sequence number means another
//! record in another journal.

use rusqlite::{Connection, OptionalExtension as _, params};
use uuid::Uuid;

use super::chain::memory_hash;

/// Place of the id among the persisted values: no gripper has an empty name.
pub(super) const NO_GRIPPER: &str = "";
const KEY: &str = "journal_id";

/// Returns the journal's id. Creates an id for a new journal, and for a journal of an earlier version.
pub(super) fn identify(connection: &Connection) -> Uuid {
    let id = read(connection).ok().flatten().unwrap_or_else(Uuid::now_v7);
    if let Err(error) = write(connection, id) {
        tracing::warn!(%error, "journal id not stored: the next start creates another one");
    }
    id
}

fn read(connection: &Connection) -> rusqlite::Result<Option<Uuid>> {
    let sql = "SELECT value, hash FROM memory WHERE gripper = ? AND key = ?";
    let row = |row: &rusqlite::Row<'_>| Ok((row.get(0)?, row.get(1)?));
    let stored: Option<(String, [u8; 32])> = connection.query_row(sql, [NO_GRIPPER, KEY], row).optional()?;
    let intact = stored.filter(|(value, hash)| *hash == memory_hash(NO_GRIPPER, KEY, value));
    Ok(intact.and_then(|(value, _)| value.parse().ok()))
}

/// Removes the id from a copy of a journal. If the copy is used, it continues with other records than the original, so it
/// is another journal.
pub(super) fn forget(copy: &Connection) -> rusqlite::Result<()> {
    copy.execute("DELETE FROM memory WHERE gripper = ? AND key = ?", [NO_GRIPPER, KEY]).map(drop)
}

fn write(connection: &Connection, id: Uuid) -> rusqlite::Result<()> {
    if read(connection)? == Some(id) {
        return Ok(());
    }
    let value = id.to_string();
    let sql = "INSERT OR REPLACE INTO memory(gripper, key, value, hash) VALUES (?, ?, ?, ?)";
    connection.execute(sql, params![NO_GRIPPER, KEY, value, memory_hash(NO_GRIPPER, KEY, &value)]).map(drop)
}
