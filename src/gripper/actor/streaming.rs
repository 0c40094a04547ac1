//! Streamed motions, sent many times a second by a client that steers a script on the device. Each is a command,
//! subject to lease and latch. This module counts them for the journal.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::time::{Duration, Instant};

use super::super::Now;
use super::super::model::{Action, Client, Motion, Submission};
use super::Actor;
use super::recording::Recording;
use crate::wsg::GripperState;

/// Time for which commands are counted before they are recorded.
const COUNTED_FOR: Duration = Duration::from_secs(1);

/// Time that a stream counts as active after its last request. Active streams have 30 or more requests a second.
const LASTS: Duration = Duration::from_secs(1);

/// Streamed commands.
#[derive(Debug, Default)]
pub(super) struct Streaming {
    /// Time of the newest streamed command.
    at: Option<Instant>,
    /// Commands since the last record, by id and client. Bounded by the device's replies in a second.
    counted: HashMap<(u8, Client), u64>,
    /// Time of the next record.
    written_at: Option<Instant>,
}

impl Streaming {
    pub(super) fn next_timeout(&self) -> Option<Instant> {
        self.written_at
    }

    /// Marks the stream as ended.
    pub(super) fn stopped(&mut self) {
        self.at = None;
    }

    /// Counts an admitted command. The first one is recorded at once.
    pub(super) fn count(&mut self, now: Now, submission: &Submission, recording: &mut Recording) {
        let Action::Motion(Motion::Custom(custom)) = &submission.action else { return };
        let (id, client) = (custom.id(), &submission.client);
        self.at = Some(now.instant);
        match self.counted.entry((id, client.clone())) {
            Entry::Occupied(mut entry) => *entry.get_mut() += 1,
            Entry::Vacant(entry) => {
                entry.insert(0);
                recording.streamed(now, id, client, 1);
            }
        }
        self.written_at.get_or_insert(now.instant + COUNTED_FOR);
    }

    /// Records the counted commands. An active stream continues to be counted, with one record a second.
    pub(super) fn write(&mut self, now: Now, recording: &mut Recording) {
        let counted = std::mem::take(&mut self.counted);
        for ((id, client), count) in counted.into_iter().filter(|(_, count)| *count > 0) {
            recording.streamed(now, id, &client, count);
            self.counted.insert((id, client), 0);
        }
        self.written_at = (!self.counted.is_empty()).then_some(now.instant + COUNTED_FOR);
    }
}

impl Actor {
    pub(super) fn is_streamed(&self, motion: &Motion) -> bool {
        matches!(motion, Motion::Custom(custom) if self.config.custom_ids.stream.contains(&custom.id()))
    }

    /// Whether a stream was active at `at`. It does not count while a part is held, since stopping the fingers could
    /// drop the part.
    pub(super) fn is_streaming(&self, at: Instant) -> bool {
        let holds = self.observed.last_state() == Some(GripperState::Holding);
        !holds && self.streaming.at.is_some_and(|streamed| at < streamed + LASTS)
    }
}
