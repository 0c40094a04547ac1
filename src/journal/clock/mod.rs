//! Doubt about the wall clock. A clock that is years ahead must not make retention remove all records. So a jump far
//! beyond the newest record holds the removal by age back, until the clock is set right, or has been synchronised with
//! a time server for an hour, or a person confirms the time.

use std::process::Command;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use jiff::{SignedDuration, Timestamp};
use rusqlite::{Connection, OptionalExtension as _};

use super::identity;
use super::row::{milliseconds, now};

/// Jump that is doubted: longer than holidays of a plant.
const JUMP: SignedDuration = SignedDuration::from_hours(30 * 24);

/// Time for which the clock has to be synchronised.
const SYNCHRONISED_FOR: Duration = Duration::from_hours(1);

/// Key of the newest plausible time, in ms since 1970, while the clock is doubtful.
const KEY: &str = "plausible_ms";

/// The wall clock compared with the records and with the monotonic clock.
#[derive(Debug)]
pub(super) struct ClockCheck {
    /// Newest plausible time, and the moment at which it was.
    plausible: (Timestamp, Instant),
    /// Time of the newest record at the start. A clock behind it, as of a machine without a battery, shows no time.
    floor: Timestamp,
    /// Whether the wall clock is doubtful.
    is_doubtful: bool,
    /// Moment since which a time server has kept the doubtful clock.
    synchronised_since: Option<Instant>,
}

impl ClockCheck {
    /// Compares the clock with the newest record, before the first one of this run.
    pub(super) fn new(connection: &Connection, at: Instant) -> rusqlite::Result<Self> {
        let newest = "SELECT at FROM events ORDER BY seq DESC LIMIT 1";
        let newest: Option<i64> = connection.query_row(newest, [], |row| row.get(0)).optional()?;
        let stored: Option<i64> = identity::value(connection, KEY)?.and_then(|ms| ms.parse().ok());
        let plausible = stored.or(newest).and_then(|ms| Timestamp::from_millisecond(ms).ok());
        let plausible = plausible.unwrap_or_else(now);
        Ok(Self {
            plausible: (plausible, at),
            floor: plausible,
            is_doubtful: stored.is_some(),
            synchronised_since: None,
        })
    }

    /// Looks at the clock. Returns whether it is doubtful. `is_synchronised` asks whether a time server keeps it.
    pub(super) fn look(
        &mut self,
        connection: &Connection,
        wall: Timestamp,
        at: Instant,
        is_synchronised: impl FnOnce() -> bool,
    ) -> bool {
        let (plausible, since) = self.plausible;
        let passed = SignedDuration::try_from(at.saturating_duration_since(since)).unwrap_or(SignedDuration::MAX);
        let jumped = wall.duration_since(plausible).saturating_sub(passed);
        if jumped <= JUMP {
            self.trust(connection, wall.max(self.floor), at);
        } else if !self.is_doubtful {
            self.is_doubtful = true;
            tracing::error!(%wall, newest_record = %plausible, "wall clock doubtful: no record is removed for its age");
            report(identity::store(connection, KEY, &milliseconds(plausible).to_string()));
        } else if !is_synchronised() {
            self.synchronised_since = None;
        } else if at.saturating_duration_since(*self.synchronised_since.get_or_insert(at)) >= SYNCHRONISED_FOR {
            self.trust(connection, wall, at);
        }
        self.is_doubtful
    }

    /// Takes the time as it is.
    pub(super) fn trust(&mut self, connection: &Connection, wall: Timestamp, at: Instant) {
        self.plausible = (wall, at);
        self.synchronised_since = None;
        if std::mem::take(&mut self.is_doubtful) {
            tracing::info!(%wall, "wall clock trusted again");
            report(identity::remove(connection, KEY));
        }
    }

    /// Describes the doubt, with the remedy.
    pub(super) fn doubt(&self) -> Option<String> {
        let (plausible, _) = self.plausible;
        self.is_doubtful.then(|| {
            format!(
                "the clock has jumped by more than 30 days, from {plausible}: no record is removed for its age; set \
                 the clock, or acknowledge this alarm if the time is right"
            )
        })
    }
}

fn report(stored: rusqlite::Result<()>) {
    if let Err(error) = stored {
        tracing::warn!(%error, "doubt about the clock not stored");
    }
}

/// Answer of the system to the question whether a time server keeps the clock. It can take half a minute, which would
/// keep records from being written, so another thread asks.
#[derive(Debug, Default)]
pub(super) struct TimeServer {
    asking: Option<JoinHandle<bool>>,
    /// The last answer.
    is_synchronised: bool,
}

impl TimeServer {
    /// Returns the last answer, and asks again.
    pub(super) fn ask(&mut self) -> bool {
        if self.asking.as_ref().is_none_or(JoinHandle::is_finished) {
            if let Some(asking) = self.asking.take() {
                self.is_synchronised = asking.join().unwrap_or_default();
            }
            self.asking = Some(std::thread::spawn(|| is_synchronised() == Some(true)));
        }
        self.is_synchronised
    }
}

/// Whether the time comes from a time server; `None` if nothing tells.
#[must_use]
pub fn is_synchronised() -> Option<bool> {
    let output = Command::new("timedatectl").args(["show", "--property=NTPSynchronized", "--value"]).output().ok()?;
    match output.stdout.trim_ascii() {
        b"yes" => Some(true),
        b"no" => Some(false),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
