//! Streamed motions, sent many times a second by a client that steers a script on the device. Each is a command,
//! subject to lease and latch. This module counts them for the journal.
//!
//! Nobody steers fingers whose stream is silent, so the gateway then sends a Stop. A Stop of anybody holds the stream off,
//! whose next target would otherwise follow a moment later: its requests are refused until it pauses.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::time::{Duration, Instant};

use super::super::Now;
use super::Actor;
use super::link::OwnStop;
use super::recording::Recording;
use model::error::Failure;
use model::{Action, Client, LeaseToken, Motion, Submission};
use wsg::{GripperState, SystemState};

/// Time for which commands are counted before they are recorded.
const COUNTED_FOR: Duration = Duration::from_secs(1);

/// Time that a stream counts as active after its last request. Active streams have 30 or more requests a second.
const LASTS: Duration = Duration::from_secs(1);

/// Pause after which a stream that was held off may begin anew.
const PAUSE: Duration = Duration::from_millis(500);

/// Time within which the flags show a motion that the last target has begun, beside the period of the updates.
pub(super) const MOVES_WITHIN: Duration = Duration::from_millis(200);

/// Interval in which fingers are looked at that do not move yet.
const LOOKS_EVERY: Duration = Duration::from_millis(20);

/// Time for the fingers to slow down after a Stop.
const STOPPED_WITHIN: Duration = Duration::from_millis(100);

/// Time after which fingers that still move without a stream get another Stop, and the number of these Stops.
const STOPPED_AGAIN_AFTER: Duration = Duration::from_millis(300);
const MAX_STOPS: u32 = 3;

/// A stream that a Stop holds off.
#[derive(Debug)]
struct HeldOff {
    /// Token of the client that streamed. Another client, or a new connection, has another.
    token: Option<LeaseToken>,
    /// Time of the Stop, or of the newest request that was refused.
    at: Instant,
}

/// Streamed commands.
#[derive(Debug, Default)]
pub(super) struct Streaming {
    /// Time of the newest streamed command.
    at: Option<Instant>,
    /// Lease token of that command, and the id of its script.
    token: Option<LeaseToken>,
    raw_id: u8,
    /// Width of its target in mm, if the limits of streams concern it.
    target_mm: Option<f32>,
    /// Time from which on the stream is silent: that of the newest command, or of its end.
    silent_since: Option<Instant>,
    /// Number of Stops that fingers without a stream have got, and the time of the next look at them.
    stops: u32,
    looks_at: Option<Instant>,
    /// Whether the stream or the servo session has ended with a Stop. A script can carry out a target that it got before.
    has_ended: bool,
    held_off: Option<HeldOff>,
    /// Commands since the last record, by id and client. Bounded by the device's replies in a second.
    counted: HashMap<(u8, Client), u64>,
    /// Time of the next record.
    written_at: Option<Instant>,
}

impl Streaming {
    pub(super) fn next_timeout(&self) -> Option<Instant> {
        self.written_at
    }

    /// Holds off the stream, if one was active: a client that steers, or a target that the device still carries out.
    pub(super) fn stopped(&mut self, now: Instant) {
        let has_steered = self.at.take().is_some_and(|at| now < at + LASTS);
        if has_steered || self.silent_since.is_some() {
            self.held_off = Some(HeldOff { token: self.token.take(), at: now });
        }
        self.watch_ended();
    }

    /// Lets a client's stream begin anew, because the client has sent a motion.
    pub(super) fn resumed(&mut self, token: Option<&LeaseToken>) {
        self.held_off.take_if(|held_off| held_off.token.as_ref() == token);
    }

    /// Leaves the fingers to another script of the client that streamed.
    pub(super) fn left(&mut self, token: Option<&LeaseToken>) {
        if self.token.as_ref() == token {
            self.at = None;
            self.watch_ended();
        }
    }

    /// Ends the watch over fingers that nobody steers.
    pub(super) fn watch_ended(&mut self) {
        (self.silent_since, self.looks_at, self.stops) = (None, None, 0);
        self.has_ended = false;
    }

    /// Watches fingers that a Stop has just stopped, which move on if a script carries out a target that it got before.
    pub(super) fn watch_after_stop(&mut self, now: Instant) {
        self.silent_since = Some(now);
        self.looks_at = Some(now + STOPPED_WITHIN);
        self.stops = 1;
        self.has_ended = true;
    }

    /// Refuses a request of a stream that is held off.
    pub(super) fn check(&mut self, now: Instant, token: Option<&LeaseToken>) -> Result<(), Failure> {
        if let Some(held_off) = self.held_off.as_mut().filter(|held_off| held_off.token.as_ref() == token) {
            if now < held_off.at + PAUSE {
                held_off.at = now;
                return Err(Failure::StoppedFirst { command: "the streamed command" });
            }
            self.held_off = None;
        }
        Ok(())
    }

    /// Notes the end of a streamed command. Fingers that have got a Stop are looked at when that is due.
    pub(super) fn answered(&mut self, now: Instant) {
        if self.has_ended {
            self.silent_since = self.silent_since.map(|_| now);
            self.looks_at = self.looks_at.map(|at| at.max(now + LOOKS_EVERY));
        } else if let Some(since) = self.silent_since.as_mut().filter(|_| self.stops == 0) {
            (*since, self.looks_at) = (now, None);
        }
    }

    /// Width in mm of the newest target, if the client of this token streams.
    pub(super) fn target_mm(&self, now: Instant, token: Option<&LeaseToken>) -> Option<f32> {
        let is_active = self.at.is_some_and(|at| now < at + LASTS) && self.token.as_ref() == token;
        self.target_mm.filter(|_| is_active)
    }

    /// Counts an admitted command. The first one is recorded at once.
    pub(super) fn count(
        &mut self,
        now: Now,
        submission: &Submission,
        target_mm: Option<f32>,
        recording: &mut Recording,
    ) {
        let Action::Motion(Motion::Custom(custom)) = &submission.action else { return };
        let id = custom.id();
        let client = &submission.client;
        (self.at, self.silent_since, self.looks_at, self.stops) = (Some(now.instant), Some(now.instant), None, 0);
        (self.token, self.raw_id, self.target_mm) = (submission.lease.clone(), id, target_mm);
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
        matches!(motion, Motion::Custom(custom) if self.config.rules.custom_ids.stream.contains(&custom.id()))
    }

    /// Time of the next look at fingers whose stream may be silent. While a command is under way, its end comes first.
    pub(super) fn stream_silent_at(&self) -> Option<Instant> {
        let since = self.streaming.silent_since.filter(|_| !self.motion.is_under_way() && self.link.is_up())?;
        let timeout = self.config.rules.custom_ids.stream_timeout;
        let is_watched = !timeout.is_zero() || self.streaming.stops > 0;
        is_watched.then(|| self.streaming.looks_at.unwrap_or(since + timeout))
    }

    /// Stops moving fingers whose stream is silent, and again if they do not stop.
    pub(super) fn stop_silent_stream(&mut self, now: Now) {
        let Some(since) = self.streaming.silent_since.filter(|_| self.latch.id().is_none()) else {
            return self.streaming.watch_ended();
        };
        let timeout = self.config.rules.custom_ids.stream_timeout;
        let timeout = if self.streaming.has_ended { Duration::ZERO } else { timeout };
        let watched_until = since + timeout + MOVES_WITHIN + self.observed.period;
        if !self.observed.has(SystemState::MOVING) {
            let has_stopped = self.streaming.stops > 0 && !self.streaming.has_ended;
            if has_stopped || now.instant >= watched_until {
                return self.streaming.watch_ended();
            }
            // The flags show a motion late.
            self.streaming.looks_at = Some(watched_until.min(now.instant + LOOKS_EVERY));
            return;
        }
        let raw_id = self.streaming.raw_id;
        let stops = self.streaming.stops;
        let has_ended = self.streaming.has_ended;
        if stops == MAX_STOPS {
            tracing::warn!(gripper = %self.config.name, "the gripper did not stop");
            return self.streaming.watch_ended();
        }
        if stops == 0 {
            tracing::warn!(gripper = %self.config.name, raw_id, "stream is silent while the fingers move: sending a Stop");
            self.recording.stream_silent(now, raw_id);
        }
        self.link.send_stop(now, OwnStop::new(None));
        self.streaming.stopped(now.instant);
        self.streaming.silent_since = Some(since);
        self.streaming.stops = stops + 1;
        self.streaming.has_ended = has_ended;
        self.streaming.looks_at = Some(now.instant + STOPPED_AGAIN_AFTER);
    }

    /// Whether a stream was active at `at`. It does not count while a part is held, since stopping the fingers could
    /// drop the part.
    pub(super) fn is_streaming(&self, at: Instant) -> bool {
        let holds = self.observed.last_state() == Some(GripperState::Holding);
        !holds && self.streaming.at.is_some_and(|streamed| at < streamed + LASTS)
    }
}
