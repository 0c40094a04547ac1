//! The head of a journal: its newest event and grip record, with their hashes. A chain of hashes cannot show that its
//! newest records were deleted, so the gateway keeps the head in a file beside the journal too, and writes it into an
//! event each hour, which webhooks and streams carry elsewhere.
//!
//! At the start, a journal that does not continue the head of the last run is another one: a restored copy, a new file,
//! or a file from which records were deleted.

use std::fmt;
use std::fs::File;
use std::io;
use std::os::unix::fs::{FileExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use rusqlite::{Connection, OptionalExtension as _};
use uuid::Uuid;

use super::chain::{Chain, Tip};
use super::identity;
use super::source::JournalLocation;
use super::store::{Store, anchor, end_of, real};
use crate::model::GatewayEvent;

/// Length of the file in bytes. Each write replaces all of them, so that none of an earlier one is left.
const LENGTH: usize = 256;

/// Key of the value that says that the journal has a head file.
const HAS_FILE: &str = "head";

/// Newest event and grip record of a journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Head([Tip; 2]);

impl Head {
    pub(super) fn new(ends: [Tip; 2]) -> Self {
        Self(ends)
    }

    /// Reads the head of a journal at this moment.
    pub(super) fn read(connection: &Connection) -> rusqlite::Result<Self> {
        Ok(Self([end_of(connection, Chain::Events)?, end_of(connection, Chain::Grips)?]))
    }

    pub(super) fn event(self) -> GatewayEvent {
        let [events, grips] = self.0;
        GatewayEvent::Head {
            up_to_seq: events.seq,
            hash: hex::encode(events.hash),
            grips_up_to_seq: grips.seq,
            grips_hash: hex::encode(grips.hash),
        }
    }

    pub(super) fn newest_event(self) -> i64 {
        self.0[Chain::Events as usize].seq
    }

    /// Compares a journal with this earlier head. Returns a text for each chain that does not continue it, or whose
    /// record was removed since, which a forged removal could hide.
    ///
    /// `is_newest` says that no later head was kept. A removal leaves the newest records, so it cannot reach that head.
    pub(super) fn differences(self, connection: &Connection, is_newest: bool) -> rusqlite::Result<Vec<String>> {
        let mut differences = Vec::new();
        for chain in Chain::ALL {
            let tip = self.0[chain as usize];
            let name = chain.name();
            let removed = anchor(connection, chain)?;
            if tip.seq < removed.seq || (is_newest && tip.seq == removed.seq && tip.seq > 0) {
                differences.push(format!("{name} {}: removed, so it cannot be compared with its head", tip.seq));
                continue;
            }
            if tip == removed {
                continue;
            }
            let sql = format!("SELECT hash FROM {name} WHERE seq = ?");
            let found: Option<[u8; 32]> = connection.query_row(&sql, [tip.seq], |row| row.get(0)).optional()?;
            match found {
                Some(hash) if hash == tip.hash => {}
                Some(_) => differences.push(format!("{name} {}: another record than its head names", tip.seq)),
                None => {
                    let first = end_of(connection, chain)?.seq + 1;
                    differences.push(format!("{name} {first} to {}: missing, but its head names the last", tip.seq));
                }
            }
        }
        Ok(differences)
    }
}

/// Writes `EVENT:HASH:GRIP:HASH`.
impl fmt::Display for Head {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [events, grips] = self.0;
        write!(f, "{}:{}:{}:{}", events.seq, hex::encode(events.hash), grips.seq, hex::encode(grips.hash))
    }
}

/// Error of a text that is not a [`Head`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a head: write EVENT:HASH:GRIP:HASH, as `wsg-gateway journal head` prints it")]
pub struct InvalidHead(String);

impl FromStr for Head {
    type Err = InvalidHead;

    fn from_str(text: &str) -> Result<Self, InvalidHead> {
        let parts: Vec<_> = text.split(':').collect();
        let ends = match parts.as_slice() {
            [event, event_hash, grip, grip_hash] => parsed(event, event_hash).zip(parsed(grip, grip_hash)),
            _ => None,
        };
        let Some((events, grips)) = ends else { return Err(InvalidHead(text.to_owned())) };
        Ok(Self([events, grips]))
    }
}

fn parsed(seq: &str, hash: &str) -> Option<Tip> {
    let mut tip = Tip { seq: seq.parse().ok()?, ..Tip::default() };
    hex::decode_to_slice(hash, &mut tip.hash).ok()?;
    Some(tip)
}

/// Content of a head file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Content {
    journal_id: Uuid,
    head: Head,
}

impl Content {
    fn parse(text: &str) -> Option<Self> {
        let (id, head) = text.trim_end().split_once(' ')?;
        Some(Self { journal_id: id.parse().ok()?, head: head.parse().ok()? })
    }
}

/// Path of a journal's head file.
fn path_of(journal: &Path) -> io::Result<PathBuf> {
    let mut name = real(journal)?.into_os_string();
    name.push("-head");
    Ok(name.into())
}

/// Reads the head that the gateway last kept of this journal; `None` if it kept none, or only that of another journal.
pub(super) fn kept(journal: &Path, connection: &Connection) -> Option<Head> {
    let content = Content::parse(&std::fs::read_to_string(path_of(journal).ok()?).ok()?)?;
    (identity::read(connection).ok()? == Some(content.journal_id)).then_some(content.head)
}

/// The open head file of a journal.
#[derive(Debug)]
pub(super) struct HeadFile {
    file: File,
    journal_id: Uuid,
    /// Whether the last write failed.
    failing: bool,
}

impl HeadFile {
    /// Opens the head file of a journal, or creates it. A journal in memory has none.
    pub(super) fn of(store: &Store, journal_id: Uuid) -> Option<Self> {
        let JournalLocation::File(journal) = &store.source.place else { return None };
        let opened = Self::open(journal, journal_id, store);
        opened.inspect_err(|error| tracing::warn!(%error, "head of the journal not kept")).ok()
    }

    fn open(journal: &Path, journal_id: Uuid, store: &Store) -> io::Result<Self> {
        let file = File::options().write(true).create(true).truncate(false).mode(0o600).open(path_of(journal)?)?;
        let head = Self { file, journal_id, failing: false };
        head.replace(Head::new(store.ends().map_err(io::Error::other)?))?;
        head.file.sync_all()?;
        identity::store(&store.connection, HAS_FILE, "1").map_err(io::Error::other)?;
        Ok(head)
    }

    /// Makes the head durable, before the record that it names can be removed.
    pub(super) fn sync(&self) {
        if let Err(error) = self.file.sync_data() {
            tracing::warn!(%error, "head of the journal not written: deleted records may remain unnoticed");
        }
    }

    /// Replaces the head. Records become durable before, so after a power failure this is at worst an earlier head.
    pub(super) fn write(&mut self, head: Head) {
        let written = self.replace(head);
        if let Err(error) = &written
            && !self.failing
        {
            tracing::warn!(%error, "head of the journal not written: deleted records may remain unnoticed");
        }
        self.failing = written.is_err();
    }

    fn replace(&self, head: Head) -> io::Result<()> {
        let text = format!("{} {head}", self.journal_id);
        self.file.write_all_at(format!("{text:<width$}\n", width = LENGTH - 1).as_bytes(), 0)
    }
}

/// Why a journal does not continue the one of the last run; `None` if it does. `is_known` says whether the journal had
/// an id.
pub(super) fn discontinuity(journal: &Path, store: &Store, journal_id: Uuid, is_known: bool) -> Option<String> {
    // An empty file has never been written.
    let kept = path_of(journal).and_then(std::fs::read_to_string).ok().filter(|text| !text.is_empty());
    let Some(text) = kept else {
        let had_file = identity::value(&store.connection, HAS_FILE).ok().flatten().is_some();
        let is_empty = store.ends().is_ok_and(|ends| ends == [Tip::default(); 2]);
        return if had_file {
            Some("its file of the head is missing, so records may be missing too".to_owned())
        } else if is_known || is_empty {
            None
        } else {
            Some("it is a copy from a backup or of version 0.1.0, which may lack the newest records".to_owned())
        };
    };
    let Some(content) = Content::parse(&text) else {
        return Some("its file of the head is damaged, so records may be missing".to_owned());
    };
    if content.journal_id != journal_id {
        return Some(format!("it is another journal than in the last run, whose head was {}", content.head));
    }
    match content.head.differences(&store.connection, true) {
        Ok(differences) if differences.is_empty() => None,
        Ok(differences) => Some(differences.join("; ")),
        Err(error) => Some(format!("it cannot be compared with its head: {error}")),
    }
}
