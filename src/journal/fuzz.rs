//! Fuzz target of the journal.

use rusqlite::{Connection, params};

use super::chain::memory_hash;
use super::recovery::recover;
use super::row::now;
use super::schema::TABLES;

/// Checks that recovery succeeds, and skips unreadable records. A line is `m` and the gripper, key and value of a persisted
/// value, or the body of an event; `r` before the body marks a running command.
pub(crate) fn recovery(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(connection) = Connection::open_in_memory() else { return };
    assert_eq!(connection.execute_batch(TABLES), Ok(()));
    let at = now().as_millisecond();
    for (seq, line) in (1_i64..).zip(text.lines()) {
        if let Some(memory) = line.strip_prefix('m') {
            let mut parts = memory.splitn(3, ' ');
            let (Some(gripper), Some(key), Some(value)) = (parts.next(), parts.next(), parts.next()) else { continue };
            let hash = memory_hash(gripper, key, value);
            let insert = "INSERT OR REPLACE INTO memory VALUES (?, ?, ?, ?)";
            assert_eq!(connection.execute(insert, params![gripper, key, value, hash]), Ok(1));
            continue;
        }
        let (is_running, body) = line.strip_prefix('r').map_or((false, line), |body| (true, body));
        let insert = "INSERT INTO events(seq, at, body, hash) VALUES (?, ?, ?, x'')";
        // The tables refuse a body that is not JSON.
        if connection.execute(insert, params![seq, at, body]).is_ok() && is_running {
            let insert = "INSERT OR REPLACE INTO running SELECT command_id, seq FROM events WHERE seq = ? \
                AND command_id IS NOT NULL";
            assert!(connection.execute(insert, [seq]).is_ok());
        }
    }
    let recovered = recover(&connection).map(|(recovered, events)| recovered.running.len() <= events.len());
    assert_eq!(recovered, Ok(true));
}
