//! The state of one link: queued requests, requests in flight and late replies. Sans-IO.
//!
//! # Usage
//!
//! - Inputs: [`Session::submit`], [`Session::withdraw`], [`Session::receive`], [`Session::handle_timeout`]. They take
//!   `now`.
//! - Outputs, to be drained after each input: [`Session::poll_event`] until `None`; [`Session::poll_transmit`] whenever
//!   the link can take a frame; then [`Session::poll_timeout`] for the time of the next [`Session::handle_timeout`].
//!
//! # Guarantees
//!
//! - At most one request per id is in flight, with two exceptions. A Stop or FAST STOP does not wait for an earlier one
//!   if a motion, a script or an acknowledgement was written between them. Switching a finger off does not wait until
//!   it has powered up, because that is executed at once (`fw4-en 3.6.3`). Ruling: the replies of this id then come in
//!   the order of the requests.
//! - FAST STOP is written before Stop, and Stop before all others. Frames are handed out one by one, so a stop waits at
//!   most for the frame being written, and for the reply to an earlier stop that stops the same motion.
//! - No motion or script is written while an earlier Stop waits to be written, because the Stop would stop it. For the
//!   same reason, no acknowledgement is written while a FAST STOP waits.
//! - Every request ends exactly once, with a reply or at its deadline, unless it is withdrawn before it was written.
//! - After a timeout, an id stays closed until the echo of a later Loop (see `barrier`), or for
//!   [`LATE_REPLIES_WITHIN`] on a device that answers no Loop. A two-step id stays closed
//!   until its late result arrives, or the device reports not MOVING after that echo. A script's id stays closed until
//!   its late reply arrives, or for [`SCRIPT_REPLIES_WITHIN`]. FAST STOP and Stop never wait for this.
//! - On a link that can duplicate frames, an answered id also stays closed until the echo of a later Loop, and for at
//!   least [`DUPLICATE_WITHIN`]. On every link, the same wait for an echo follows each answered request of an id that
//!   has once received a reply without a request. Stop, FAST STOP and ids with automatic updates never wait for this.
//!
//! Architecture invariant: a request is written at most once. The session repeats only its own Loop.

mod barrier;
mod config;
mod event;
mod lanes;
mod received;
mod slots;

use std::collections::{BTreeSet, VecDeque};
use std::time::{Duration, Instant};

use super::decoder::{Decoder, DecoderCounters};
use super::frame::{self, ChecksumEvaluation};
use super::timed_decoder::{RESYNC_PAUSE, TimedDecoder};
use super::{Command, id};
use barrier::Barrier;
pub use config::{MAX_LINE_TIME_WHILE_MOVING, SessionConfig};
pub use event::{End, NoValue, SessionEvent};
use lanes::{Lanes, Waiting};
pub use lanes::{MAX_WAITING, MAX_WAITING_PER_ID};
use slots::{Closed, InFlight, SlotState, Slots};

/// Time limit for the result of a stopped motion. The manual does not promise one (`fw4-en 3.2.3`).
pub const ABORT_GRACE: Duration = Duration::from_millis(250);

/// Time limit for a late result from a device that has stopped moving.
pub const RESULT_GRACE: Duration = Duration::from_secs(1);

/// Time for which a script's late reply is awaited, counted from its request, or from the time limit of its result.
/// Scripts run beside the device's own commands, so the echo of a later Loop does not mean that no reply can follow.
pub const SCRIPT_REPLIES_WITHIN: Duration = Duration::from_secs(10);

/// Shortest time for which an id stays closed after its reply on a link that can duplicate frames, because a late or
/// duplicate reply can arrive after the echo of a later Loop.
pub const DUPLICATE_WITHIN: Duration = Duration::from_millis(5);

/// Time for which late replies are awaited from a device that has never answered Loop, and so cannot separate them from
/// new ones: longer than the wait for a reply.
pub const LATE_REPLIES_WITHIN: Duration = Duration::from_secs(3);

/// Silence after which a Loop probes whether the device is still there.
pub const PROBE_AFTER: Duration = Duration::from_millis(500);

/// The same while the fingers may move on one of the slowest lines: longer than the period of its updates.
const LONG_PROBE_AFTER: Duration = Duration::from_millis(1250);

/// Silence on a slow line, in bytes, that counts as a pause.
const PAUSE_BYTES: usize = 2;

/// Payload size of the longest automatic update: a status and four bytes.
const LONGEST_UPDATE_BYTES: usize = 6;

/// Handle of a request until it ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Token(u64);

/// A request to the device.
#[derive(Debug, Clone)]
pub struct Request {
    /// Command to send.
    pub command: Command,
    /// Time limit for writing the request, and again for its first reply, each beyond its line time.
    pub reply_within: Duration,
    /// Time limit for the result after `E_CMD_PENDING`.
    pub result_within: Duration,
}

/// Reason why a request was rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NotTaken {
    /// Too many requests are already waiting.
    #[error("{limit} requests are already waiting")]
    Full {
        /// [`MAX_WAITING`], or [`MAX_WAITING_PER_ID`] requests of this id.
        limit: usize,
    },
    /// An earlier request of the same script had no reply, which can still arrive.
    #[error("the script has not replied to an earlier request")]
    Unanswered,
    /// The fingers may be moving, and the request takes longer than [`MAX_LINE_TIME_WHILE_MOVING`] on the line.
    #[error("request would occupy the line for {line_ms} ms while the fingers move")]
    LineTime {
        /// Line time of the request in ms.
        line_ms: u64,
    },
}

/// Counters of a session since its creation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Frames handed out to be written.
    pub frames_sent: u64,
    /// Bytes handed out to be written.
    pub bytes_sent: u64,
    /// Replies that belonged to an earlier request of their id.
    pub late_replies: u64,
    /// Replies of an id without a request.
    pub stray_replies: u64,
    /// Replies with a correct checksum but impossible contents.
    pub invalid_replies: u64,
    /// Requests that ended at a deadline.
    pub time_outs: u64,
    /// Frames of the gateway's own that came back.
    pub echoes: u64,
}

/// Protocol state of one link.
#[derive(Debug)]
pub struct Session {
    config: SessionConfig,
    decoder: TimedDecoder,
    lanes: Lanes,
    slots: Slots,
    barrier: Barrier,
    events: VecDeque<SessionEvent>,
    counters: Counters,
    round_trip: Option<Duration>,
    /// The newest frame handed out, to recognise a line that returns it.
    last_written: Vec<u8>,
    /// Ids with replies longer than the manuals say.
    long_replies: BTreeSet<u8>,
    /// Ids that have received a reply without a request, so that others can follow.
    repeated: BTreeSet<u8>,
    /// Order of the newest motion, script or acknowledgement written. An earlier stop does not stop what it begins.
    newest_start: Option<u64>,
    next_token: u64,
    moving: bool,
    last_heard: Instant,
}

impl Session {
    /// Creates a session on a newly established link.
    #[must_use]
    pub fn new(config: SessionConfig, now: Instant) -> Self {
        let barrier = Barrier::new(config.nonce_seed);
        let decoder = Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
        let frame_within = config.line_time(frame::OVERHEAD_BYTES + id::MAX_LOOP_BYTES) + config.frame_gap;
        let resync_pause = RESYNC_PAUSE.max(config.line_time(PAUSE_BYTES));
        Self {
            config,
            decoder: TimedDecoder::new(decoder, frame_within, resync_pause).with_limited_loss(),
            lanes: Lanes::default(),
            slots: Slots::default(),
            barrier,
            events: VecDeque::new(),
            counters: Counters::default(),
            round_trip: None,
            last_written: Vec::new(),
            long_replies: BTreeSet::new(),
            repeated: BTreeSet::new(),
            newest_start: None,
            next_token: 0,
            moving: false,
            last_heard: now,
        }
    }

    /// Queues a request. It ends with exactly one [`SessionEvent::Ended`], unless it is withdrawn.
    ///
    /// # Errors
    /// [`NotTaken`] if too many are waiting, the script has not replied to an earlier request, or the request is too
    /// long for the line while the fingers move. No event follows.
    pub fn submit(&mut self, now: Instant, request: Request) -> Result<Token, NotTaken> {
        let line_time = self.config.line_time_of(&request.command);
        if self.may_move() && self.config.is_too_long(&request.command) {
            return Err(NotTaken::LineTime { line_ms: line_time.as_millis() as u64 });
        }
        if self.slots.awaits_script(request.command.id()) {
            return Err(NotTaken::Unanswered);
        }
        let token = Token(self.next_token);
        let deadline = now + request.reply_within + line_time;
        // A Stop can wait for the end of the Stop in flight, so its own deadline comes after that one's.
        let before = self.slots.in_flight().find(|(id, _)| *id == id::STOP && request.command == Command::Stop);
        let deadline = before.map_or(deadline, |(_, before)| deadline.max(before.deadline + request.reply_within));
        self.lanes.push(Waiting { token, request, deadline })?;
        self.next_token += 1;
        Ok(token)
    }

    /// Withdraws an unwritten request. Returns `true` if it was withdrawn; then no event follows.
    pub fn withdraw(&mut self, token: Token) -> bool {
        self.lanes.withdraw(token)
    }

    /// Whether a request of `id` is waiting to be written.
    #[must_use]
    pub fn has_waiting(&self, id: u8) -> bool {
        self.lanes.has_waiting(id)
    }

    /// Processes bytes received from the link.
    pub fn receive(&mut self, now: Instant, bytes: &[u8]) {
        self.decoder.push(now, bytes);
        self.decode(now);
        if self.decoder.is_partial() {
            // An incomplete frame on a slow line is a sign of life; the decoder bounds its duration.
            self.last_heard = now;
        }
    }

    /// Processes expired deadlines. Call it at the time given by [`Session::poll_timeout`].
    pub fn handle_timeout(&mut self, now: Instant) {
        self.expect_opaque_replies();
        self.decoder.handle_timeout(now);
        self.decode(now);
        self.barrier.handle_timeout(now);
        while let Some(expired) = self.lanes.pop_expired(now) {
            self.counters.time_outs += 1;
            let waited = expired.request.reply_within;
            self.events.push_back(SessionEvent::Ended(
                expired.token,
                End::Unanswered { written: false, stopped: false, waited },
            ));
        }
        self.expire_in_flight(now);
        self.expire_scripts(now);
        self.slots.expire_duplicates(now);
        if self.barrier.is_deaf() {
            self.slots.stop_waiting_for_echoes(now);
        }
        if self.probes_at() <= now {
            self.barrier.probe();
        }
    }

    /// Returns the oldest event.
    pub fn poll_event(&mut self) -> Option<SessionEvent> {
        self.events.pop_front()
    }

    /// Appends the next frame to `out`. Returns whether there was one. Call it only when the link can take a frame,
    /// because a frame handed out counts as written.
    pub fn poll_transmit(&mut self, now: Instant, out: &mut Vec<u8>) -> bool {
        let before = out.len();
        // A client's Loop and the session's own share one id, so only one can be in flight.
        let loop_busy = self.barrier.is_in_flight();
        let first_stop = self.lanes.first_stop();
        let fast_stop_waits = self.has_waiting(id::FAST_STOP);
        let may_move = self.may_move();
        let is_open = |waiting: &Waiting| {
            let command = &waiting.request.command;
            let id = command.id();
            let is_after_stop = first_stop.is_some_and(|stop| stop < waiting.token);
            let is_stop = matches!(command, Command::Stop | Command::FastStop);
            (self.slots.is_open(id)
                || is_stop && self.slots.admit_another(id, self.newest_start)
                || command.is_power_off() && self.slots.is_powering_up(id))
                && !(loop_busy && id == id::LOOP)
                && !(is_after_stop && id::is_motion_or_script(id))
                && !(fast_stop_waits && id == id::ACKNOWLEDGE_FAST_STOP)
                // The fingers may have begun to move since the request was taken.
                && !(may_move && self.config.is_too_long(command))
                // Only a stop may still be written after its deadline, as when the process was frozen.
                && (waiting.deadline > now || is_stop)
        };
        if let Some(waiting) = self.lanes.pop_urgent(is_open) {
            self.write(now, waiting, out);
        } else if self.barrier.is_wanted() && !self.loop_in_flight() {
            let allowance = self.round_trip_line_time(frame::OVERHEAD_BYTES + barrier::NONCE_BYTES, id::LOOP);
            let nonce = self.barrier.start(now, allowance);
            frame::encode(id::LOOP, &nonce, out);
        } else if let Some(waiting) = self.lanes.pop_rest(is_open) {
            self.write(now, waiting, out);
        } else {
            return false;
        }
        self.counters.frames_sent += 1;
        self.counters.bytes_sent += (out.len() - before) as u64;
        self.last_written.clear();
        self.last_written.extend_from_slice(&out[before..]);
        true
    }

    /// Time of the next call of [`Session::handle_timeout`].
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let in_flight = self.slots.in_flight().map(|(_, in_flight)| in_flight.deadline).min();
        let probe = (!self.barrier.is_in_flight() && !self.barrier.is_wanted()).then(|| self.probes_at());
        let waiting = self.lanes.next_deadline();
        let script = self.slots.script_deadline();
        let barrier = self.barrier.deadline();
        let duplicate = self.slots.duplicate_deadline();
        let echo = if self.barrier.is_deaf() { self.slots.echo_deadline() } else { None };
        let deadlines = [in_flight, waiting, script, duplicate, barrier, self.decoder.deadline(), probe, echo];
        deadlines.into_iter().flatten().min()
    }

    /// Time at which a valid frame, or part of a possible frame, was last received.
    #[must_use]
    pub fn last_heard(&self) -> Instant {
        self.last_heard
    }

    /// Whether a request that acts on the gripper was written, and nothing shows that the device has received it. It may
    /// still wait in a buffer on the way.
    #[must_use]
    pub fn may_act_late(&self) -> bool {
        self.slots.may_act_late()
    }

    /// Requests a Loop, to measure the round trip.
    pub fn probe(&mut self) {
        self.barrier.probe();
    }

    /// Number of Loops in a row without an echo; 0 if the device has never echoed one.
    #[must_use]
    pub fn unanswered_loops(&self) -> u32 {
        if self.barrier.has_echoed() { self.barrier.unanswered() } else { 0 }
    }

    /// Whether the device has answered none of several Loops in this session. Late replies are then told from new ones
    /// by time alone.
    #[must_use]
    pub fn is_deaf(&self) -> bool {
        self.barrier.is_deaf()
    }

    /// Takes the newest round-trip time of a Loop; returns each only once.
    pub fn take_loop_round_trip(&mut self) -> Option<Duration> {
        self.barrier.take_round_trip()
    }

    /// Whether no request is waiting or in flight.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.lanes.is_empty() && self.slots.in_flight().next().is_none()
    }

    /// Takes the newest round-trip time of a request other than Loop: from handing it out to its first reply. Returns
    /// each only once.
    pub fn take_round_trip(&mut self) -> Option<Duration> {
        self.round_trip.take()
    }

    /// Current counter values of the session.
    #[must_use]
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Current counter values of the decoder.
    #[must_use]
    pub fn decoder_counters(&self) -> DecoderCounters {
        self.decoder.counters()
    }

    /// Time at which a Loop probes whether the device is still there. On the slowest lines, it comes later while the
    /// fingers may move, because a FAST STOP would have to wait for it: periodic updates come first.
    fn probes_at(&self) -> Instant {
        let line_time = self.config.line_time(frame::OVERHEAD_BYTES + barrier::NONCE_BYTES);
        let is_long = self.may_move() && line_time > MAX_LINE_TIME_WHILE_MOVING;
        self.last_heard + if is_long { LONG_PROBE_AFTER } else { PROBE_AFTER }
    }

    /// Whether the fingers move, or can begin to move because of a motion whose end is not known.
    fn may_move(&self) -> bool {
        self.moving || self.slots.has_motion()
    }

    /// Line time of the request, of an update in transmission, and of the longest reply.
    fn round_trip_line_time(&self, request_bytes: usize, id: u8) -> Duration {
        let reply_bytes = frame::OVERHEAD_BYTES + id::max_reply_bytes(id).min(id::MAX_LOOP_BYTES);
        self.config.line_time(request_bytes + frame::OVERHEAD_BYTES + LONGEST_UPDATE_BYTES + reply_bytes)
    }

    fn loop_in_flight(&self) -> bool {
        self.slots.in_flight().any(|(id, _)| id == id::LOOP)
    }

    fn write(&mut self, now: Instant, waiting: Waiting, out: &mut Vec<u8>) {
        let Request { command, reply_within, result_within } = waiting.request;
        let before = out.len();
        command.encode(out);
        let line_time = match command {
            // Line time must not delay the repetition of a FAST STOP.
            Command::FastStop => Duration::ZERO,
            _ => self.round_trip_line_time(out.len() - before, command.id()),
        };
        if id::is_motion_or_script(command.id()) || command.id() == id::ACKNOWLEDGE_FAST_STOP {
            self.newest_start = Some(self.counters.frames_sent);
        }
        let echo = if let Command::Loop(data) = &command { Some(data.as_bytes().to_vec()) } else { None };
        let in_flight = InFlight {
            token: waiting.token,
            sent_at: now,
            deadline: now + reply_within + line_time,
            result_within,
            accepted: false,
            two_step: command.is_two_step(),
            stopped: false,
            echo,
            order: self.counters.frames_sent,
        };
        self.slots.insert(command.id(), in_flight);
    }

    /// Shortens the wait for the results of accepted motions to [`RESULT_GRACE`], for a device that may have restarted.
    pub fn expect_results(&mut self, now: Instant) {
        for (id, in_flight) in self.slots.in_flight_mut() {
            if id::is_motion(id) && in_flight.accepted {
                in_flight.deadline = in_flight.deadline.min(now + RESULT_GRACE);
            }
        }
    }

    /// Expects aborts of motions written before the stop, but not of those written after it.
    fn expect_aborts_before(&mut self, now: Instant, order: u64) {
        for (id, in_flight) in self.slots.in_flight_mut() {
            if id::is_motion(id) && in_flight.order < order {
                in_flight.stopped = true;
                in_flight.deadline = in_flight.deadline.min(now + ABORT_GRACE);
            }
        }
    }

    fn expire_in_flight(&mut self, now: Instant) {
        let Self { slots, barrier, events, counters, .. } = self;
        slots.retain(|slot| {
            let SlotState::InFlight(in_flight) = &slot.state else { return true };
            if in_flight.deadline > now {
                return true;
            }
            counters.time_outs += 1;
            let end = if in_flight.accepted {
                End::NoResult { stopped: in_flight.stopped }
            } else {
                let waited = now.saturating_duration_since(in_flight.sent_at);
                End::Unanswered { written: true, stopped: in_flight.stopped, waited }
            };
            events.push_back(SessionEvent::Ended(in_flight.token, end));
            if matches!(slot.id, id::STOP | id::FAST_STOP) {
                return false;
            }
            let since = if in_flight.accepted { now } else { in_flight.sent_at };
            let script_until = id::is_custom(slot.id).then(|| since + SCRIPT_REPLIES_WITHIN);
            let two_step = in_flight.two_step;
            let closed = Closed { two_step, script_until, ..Closed::until_echo(now, barrier.want()) };
            slot.state = SlotState::Closed(closed);
            true
        });
    }

    /// Waits for one more echo instead of for a script's reply, which can still be on its way.
    fn expire_scripts(&mut self, now: Instant) {
        for closed in self.slots.closed_mut() {
            if closed.script_until.is_some_and(|until| until <= now) {
                *closed = Closed::until_echo(now, self.barrier.want());
            }
        }
    }
}

#[cfg(test)]
mod tests;
