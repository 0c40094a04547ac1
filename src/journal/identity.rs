//! Values of the journal itself, which are stored beside the persisted values of grippers: above all its unique id,
//! created with the journal. The same sequence number means another record in another journal.

use rusqlite::{Connection, OptionalExtension as _, params};
use uuid::Uuid;

use super::chain::memory_hash;

/// Place of these values among the persisted values: no gripper has an empty name.
pub(super) const NO_GRIPPER: &str = "";
const ID: &str = "journal_id";

/// JournalIdentity of a journal.
#[derive(Debug, Clone, Copy)]
pub(super) struct JournalIdentity {
    pub(super) id: Uuid,
    /// Whether the file had the id before. A new file has none, nor has a copy, or a journal of an early version.
    pub(super) is_known: bool,
}

/// Returns the journal's id. Creates an id for a journal without one.
pub(super) fn identify(connection: &Connection) -> JournalIdentity {
    let known = read(connection).ok().flatten();
    let id = known.unwrap_or_else(Uuid::now_v7);
    if known.is_none()
        && let Err(error) = store_id(connection, id)
    {
        tracing::warn!(%error, "journal id not stored: the next start creates another one");
    }
    JournalIdentity { id, is_known: known.is_some() }
}

pub(super) fn read(connection: &Connection) -> rusqlite::Result<Option<Uuid>> {
    Ok(value(connection, ID)?.and_then(|value| value.parse().ok()))
}

/// Reads a value; `None` if it is missing or damaged.
pub(super) fn value(connection: &Connection, key: &str) -> rusqlite::Result<Option<String>> {
    let sql = "SELECT value, hash FROM memory WHERE gripper = ? AND key = ?";
    let stored: Option<(String, [u8; 32])> =
        connection.query_row(sql, [NO_GRIPPER, key], |row| Ok((row.get(0)?, row.get(1)?))).optional()?;
    let intact = stored.filter(|(value, hash)| *hash == memory_hash(NO_GRIPPER, key, value));
    Ok(intact.map(|(value, _)| value))
}

/// Removes these values from a copy of a journal. If the copy is used, it continues with other records than the original,
/// so it is another journal.
pub(super) fn forget(copy: &Connection) -> rusqlite::Result<()> {
    copy.execute("DELETE FROM memory WHERE gripper = ?", [NO_GRIPPER]).map(drop)
}

pub(super) fn store_id(connection: &Connection, id: Uuid) -> rusqlite::Result<()> {
    store(connection, ID, &id.to_string())
}

pub(super) fn store(connection: &Connection, key: &str, value: &str) -> rusqlite::Result<()> {
    let sql = "INSERT OR REPLACE INTO memory(gripper, key, value, hash) VALUES (?, ?, ?, ?)";
    let hash = memory_hash(NO_GRIPPER, key, value);
    connection.execute(sql, params![NO_GRIPPER, key, value, hash]).map(drop)
}

pub(super) fn remove(connection: &Connection, key: &str) -> rusqlite::Result<()> {
    connection.execute("DELETE FROM memory WHERE gripper = ? AND key = ?", [NO_GRIPPER, key]).map(drop)
}
