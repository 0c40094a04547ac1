//! Motions that come many times a second, from a client that steers a script on the device. Each is a command, held to
//! lease and latch; what they have of their own is here.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::time::{Duration, Instant};

use super::super::Now;
use super::super::model::{Action, Client, Detail, DeviceEvent, Motion, Submission};
use super::Actor;
use crate::wsg::GripperState;

/// How often what was counted is written down.
const COUNTED_FOR: Duration = Duration::from_secs(1);

/// How long a stream goes on without a request: those in use have 30 and more a second.
const LASTS: Duration = Duration::from_secs(1);

/// What was streamed.
#[derive(Debug, Default)]
pub(super) struct Streaming {
    /// When it was last.
    at: Option<Instant>,
    /// How often since that was written down last, by id and client: no more of them than the device answers in a second.
    counted: HashMap<(u8, Client), u64>,
    /// When that is to be written down.
    written_at: Option<Instant>,
}

impl Streaming {
    pub(super) fn next_timeout(&self) -> Option<Instant> {
        self.written_at
    }

    /// It was ended in order.
    pub(super) fn stopped(&mut self) {
        self.at = None;
    }
}

impl Actor {
    /// Whether it is one of many that steer the fingers.
    pub(super) fn is_streamed(&self, motion: &Motion) -> bool {
        matches!(motion, Motion::Custom(custom) if self.config.custom_ids.stream.contains(&custom.id()))
    }

    /// Whether the fingers are being steered, as far as was known at `at`. Fingers that hold a part, and don't move,
    /// are not: to stop them may drop it.
    pub(super) fn is_streaming(&self, at: Instant) -> bool {
        let holds = self.observed.gripper_state == Some(GripperState::Holding);
        !holds && self.streaming.at.is_some_and(|streamed| at < streamed + LASTS)
    }

    /// Counts one that was admitted: the first of a second is written down at once.
    pub(super) fn count_streamed(&mut self, now: Now, submission: &Submission) {
        let Action::Motion(Motion::Custom(custom)) = &submission.action else { return };
        let (id, client) = (custom.id(), &submission.client);
        self.streaming.at = Some(now.instant);
        match self.streaming.counted.entry((id, client.clone())) {
            Entry::Occupied(mut entry) => *entry.get_mut() += 1,
            Entry::Vacant(entry) => {
                entry.insert(0);
                self.record_streamed(now, id, client, 1);
            }
        }
        self.streaming.written_at.get_or_insert(now.instant + COUNTED_FOR);
    }

    /// Writes down what was counted. What goes on is counted on, so that it costs one record a second.
    pub(super) fn write_streamed(&mut self, now: Now) {
        let counted = std::mem::take(&mut self.streaming.counted);
        for ((id, client), count) in counted.into_iter().filter(|(_, count)| *count > 0) {
            self.record_streamed(now, id, &client, count);
            self.streaming.counted.insert((id, client), 0);
        }
        self.streaming.written_at = (!self.streaming.counted.is_empty()).then_some(now.instant + COUNTED_FOR);
    }

    fn record_streamed(&mut self, now: Now, raw_id: u8, client: &Client, count: u64) {
        let event = self.event(now, Detail::Device(DeviceEvent::Streamed { raw_id, count })).by(client);
        self.record(event);
    }
}
