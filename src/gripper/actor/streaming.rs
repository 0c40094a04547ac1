//! Motions that come many times a second, from a client that steers a script on the device. Each is a command, held to
//! lease and latch. Their counting is here.

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

/// Time that a stream goes on without a request: streams in use have 30 requests a second and more.
const LASTS: Duration = Duration::from_secs(1);

/// Streamed commands.
#[derive(Debug, Default)]
pub(super) struct Streaming {
    /// Time of the newest.
    at: Option<Instant>,
    /// Commands since the last record, by id and client: no more of them than the device answers in a second.
    counted: HashMap<(u8, Client), u64>,
    /// Time of the next record.
    written_at: Option<Instant>,
}

impl Streaming {
    pub(super) fn next_timeout(&self) -> Option<Instant> {
        self.written_at
    }

    /// The stream was ended in order.
    pub(super) fn stopped(&mut self) {
        self.at = None;
    }

    /// Counts an admitted command: the first of a second is recorded at once.
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

    /// Records the commands that were counted. A stream that goes on is counted on, at the cost of one record a second.
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
    /// Whether a motion is one of many commands that steer the fingers.
    pub(super) fn is_streamed(&self, motion: &Motion) -> bool {
        matches!(motion, Motion::Custom(custom) if self.config.custom_ids.stream.contains(&custom.id()))
    }

    /// Whether the fingers are being steered, as far as was known at `at`. Fingers that hold a part, and don't move,
    /// are not: to stop them may drop it.
    pub(super) fn is_streaming(&self, at: Instant) -> bool {
        let holds = self.observed.gripper_state == Some(GripperState::Holding);
        !holds && self.streaming.at.is_some_and(|streamed| at < streamed + LASTS)
    }
}
