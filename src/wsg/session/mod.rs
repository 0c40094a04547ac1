//! The state of one link: what waits, what is in flight, what is late. Sans-IO.
//!
//! # How it is driven
//!
//! - Inputs: [`Session::submit`], [`Session::withdraw`], [`Session::receive`], [`Session::handle_timeout`]. They take
//!   `now`.
//! - Outputs, to be drained after each input: [`Session::poll_event`] until `None`; [`Session::poll_transmit`] whenever
//!   the link can take a frame; then [`Session::poll_timeout`] says when to call [`Session::handle_timeout`].
//!
//! # What it guarantees
//!
//! One request of an id is in flight. FAST STOP is written before Stop, and Stop before the rest; since frames are
//! handed out one by one, each waits for the frame being written at most. Every request ends, once: with a reply, or
//! by its deadline. After a time-out the id is closed until the echo of a Loop that was sent later (see `barrier`); a
//! two-step id until its late result has come, or the device has been seen not MOVING after that echo. FAST STOP and
//! Stop never wait for any of that.
//!
//! Architecture invariant: a request is written at most once. Nothing in here sends anything again but the Loop.

mod barrier;
mod lanes;
mod received;
mod slots;

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::frame::{self, ChecksumEvaluation, Decoder, DecoderCounters};
use super::reply::{Data, InvalidReply, Reply};
use super::{Command, id};
use barrier::Barrier;
pub use lanes::MAX_WAITING;
use lanes::{Lanes, Waiting};
use slots::{Closed, InFlight, SlotState, Slots};

/// How much line time one request may take while the fingers move: what a FAST STOP may have to wait for.
pub const MAX_LINE_TIME_WHILE_MOVING: Duration = Duration::from_millis(100);

/// How long the result of a stopped motion is waited for: nothing says that it comes at all (`fw4-en 3.2.3`).
pub const ABORT_GRACE: Duration = Duration::from_millis(250);

/// How long a result may still be on its way from a device that has stopped moving.
pub const RESULT_GRACE: Duration = Duration::from_secs(1);

/// How long nothing may have been heard before a Loop is sent to see whether the device is still there.
pub const PROBE_AFTER: Duration = Duration::from_millis(500);

/// The payload of the longest automatic update: a status and four bytes.
const LONGEST_UPDATE_BYTES: usize = 6;

/// What a session has to know of its link.
#[derive(Debug, Clone)]
pub struct Config {
    /// How fast the line is, where that matters: none for TCP.
    pub bytes_per_second: Option<u32>,
    /// How long a frame may take from its first byte to its last, beyond its line time.
    pub frame_gap: Duration,
    /// Whether a frame may come twice: then an id that was answered stays closed until what could come again has come.
    pub may_duplicate: bool,
    /// Makes the nonces of this session differ from those of an earlier one.
    pub nonce_seed: u64,
}

/// Names a request for as long as it is under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Token(u64);

/// A request to the device.
#[derive(Debug, Clone)]
pub struct Request {
    /// What is asked.
    pub command: Command,
    /// How long it may wait to be written, and then again for its first reply, beyond the line time of both.
    pub reply_within: Duration,
    /// How long the result may take, once it was accepted with `E_CMD_PENDING`.
    pub result_within: Duration,
}

/// Why a request was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NotTaken {
    /// [`MAX_WAITING`] requests wait already.
    #[error("{MAX_WAITING} requests wait already")]
    Full,
    /// It would keep the line busy for longer than [`MAX_LINE_TIME_WHILE_MOVING`], and the fingers move.
    #[error("it would take {line_ms} ms of line time while the fingers move")]
    LineTime {
        /// How long it would take.
        line_ms: u64,
    },
}

/// What happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// The device has accepted a request with `E_CMD_PENDING`; its result follows.
    Accepted(Token),
    /// A request has ended.
    Ended(Token, End),
    /// A value of 40h, 41h, 43h, 44h or 45h, by an automatic update or by a reply.
    Update(Data),
}

/// How a request ended.
#[derive(Debug, Clone, PartialEq)]
pub enum End {
    /// With a reply.
    Reply(Reply),
    /// With a reply that can't be one. Never a motion's: for that, it is as good as none.
    Invalid(InvalidReply),
    /// Without any reply in time.
    Unanswered {
        /// Whether its frame was handed out: if not, the device never saw it.
        written: bool,
        /// Whether a Stop or FAST STOP was confirmed meanwhile.
        stopped: bool,
        /// How long it was waited for.
        waited: Duration,
    },
    /// Accepted, and then without a result in time.
    NoResult {
        /// Whether a Stop or FAST STOP was confirmed meanwhile, which explains it.
        stopped: bool,
    },
}

/// What a session has seen since it was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Frames handed out to be written.
    pub frames_sent: u64,
    /// Bytes handed out to be written.
    pub bytes_sent: u64,
    /// Replies that belonged to an earlier request of their id.
    pub late_replies: u64,
    /// Replies of an id that nothing was asked of.
    pub stray_replies: u64,
    /// Replies with a right checksum and impossible contents.
    pub invalid_replies: u64,
    /// Requests that ended by a deadline.
    pub time_outs: u64,
}

/// One link's protocol state.
#[derive(Debug)]
pub struct Session {
    config: Config,
    decoder: Decoder,
    lanes: Lanes,
    slots: Slots,
    barrier: Barrier,
    events: VecDeque<Event>,
    counters: Counters,
    round_trip: Option<Duration>,
    next_token: u64,
    moving: bool,
    last_heard: Instant,
    /// The stream position of a frame that waits for its rest, and since when.
    partial: Option<(u64, Instant)>,
}

impl Session {
    /// A session on a link that has just come up.
    #[must_use]
    pub fn new(config: Config, now: Instant) -> Self {
        let barrier = Barrier::new(config.nonce_seed);
        Self {
            config,
            decoder: Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On),
            lanes: Lanes::default(),
            slots: Slots::default(),
            barrier,
            events: VecDeque::new(),
            counters: Counters::default(),
            round_trip: None,
            next_token: 0,
            moving: false,
            last_heard: now,
            partial: None,
        }
    }

    /// Takes a request. It ends with one [`Event::Ended`], unless it is withdrawn.
    ///
    /// # Errors
    /// [`NotTaken`]: nothing will be written, and no event follows.
    pub fn submit(&mut self, now: Instant, request: Request) -> Result<Token, NotTaken> {
        let line_time = self.line_time_of(&request.command);
        if self.moving && line_time > MAX_LINE_TIME_WHILE_MOVING {
            return Err(NotTaken::LineTime { line_ms: line_time.as_millis() as u64 });
        }
        let token = Token(self.next_token);
        let deadline = now + request.reply_within + line_time;
        self.lanes.push(Waiting { token, request, deadline }).map_err(|_| NotTaken::Full)?;
        self.next_token += 1;
        Ok(token)
    }

    /// Takes a request back that has not been written: `true` if it was, and then no event follows.
    pub fn withdraw(&mut self, token: Token) -> bool {
        self.lanes.withdraw(token)
    }

    /// Whether a request of this id waits to be written.
    #[must_use]
    pub fn has_waiting(&self, id: u8) -> bool {
        self.lanes.has_waiting(id)
    }

    /// Takes bytes off the link.
    pub fn receive(&mut self, now: Instant, bytes: &[u8]) {
        self.decoder.push(bytes);
        self.decode(now);
        if self.partial.is_some() {
            // A long frame on a slow line is a sign of life while it comes, which is not for long.
            self.last_heard = now;
        }
    }

    /// To be called when [`Session::poll_timeout`] has come.
    pub fn handle_timeout(&mut self, now: Instant) {
        if self.partial_deadline().is_some_and(|deadline| deadline <= now) {
            self.decoder.give_up_partial();
            self.decode(now);
        }
        self.barrier.handle_timeout(now);
        while let Some(expired) = self.lanes.pop_expired(now) {
            self.counters.time_outs += 1;
            let waited = expired.request.reply_within;
            self.events
                .push_back(Event::Ended(expired.token, End::Unanswered { written: false, stopped: false, waited }));
        }
        self.expire_in_flight(now);
        if now >= self.last_heard + PROBE_AFTER {
            self.barrier.probe();
        }
    }

    /// What happened, oldest first.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Appends the next frame to `out`, if there is one. Call it only when the link can take a frame: what is handed
    /// out counts as written.
    pub fn poll_transmit(&mut self, now: Instant, out: &mut Vec<u8>) -> bool {
        let before = out.len();
        // A user's Loop and ours share their id, and one of an id is in flight.
        let loop_busy = self.barrier.is_in_flight();
        let is_open = |id| self.slots.is_open(id) && !(loop_busy && id == id::LOOP);
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
        true
    }

    /// When to call [`Session::handle_timeout`] next.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let in_flight = self.slots.in_flight().map(|(_, in_flight)| in_flight.deadline).min();
        let probe = (!self.barrier.is_in_flight() && !self.barrier.is_wanted()).then(|| self.last_heard + PROBE_AFTER);
        let deadlines =
            [in_flight, self.lanes.next_deadline(), self.barrier.deadline(), self.partial_deadline(), probe];
        deadlines.into_iter().flatten().min()
    }

    /// When a valid frame, or a part of what may become one, was last received.
    #[must_use]
    pub fn last_heard(&self) -> Instant {
        self.last_heard
    }

    /// Whether nothing waits and nothing is in flight.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.lanes.is_empty() && self.slots.in_flight().next().is_none()
    }

    /// How long the device took for its newest first answer to a request, once: from when that was handed out.
    pub fn take_round_trip(&mut self) -> Option<Duration> {
        self.barrier.take_round_trip().or(self.round_trip.take())
    }

    /// What was seen so far.
    #[must_use]
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// What the decoder has seen so far.
    #[must_use]
    pub fn decoder_counters(&self) -> DecoderCounters {
        self.decoder.counters()
    }

    fn line_time(&self, bytes: usize) -> Duration {
        self.config.bytes_per_second.map_or(Duration::ZERO, |bytes_per_second| {
            Duration::from_secs_f64(bytes as f64 / f64::from(bytes_per_second.max(1)))
        })
    }

    fn line_time_of(&self, command: &Command) -> Duration {
        let mut frame = Vec::new();
        command.encode(&mut frame);
        self.line_time(frame.len())
    }

    /// Of a request of so many bytes, of the update that the device may be sending, and of its longest reply.
    fn round_trip_line_time(&self, request_bytes: usize, id: u8) -> Duration {
        let reply_bytes = frame::OVERHEAD_BYTES + id::max_reply_bytes(id).min(id::MAX_LOOP_BYTES);
        self.line_time(request_bytes + frame::OVERHEAD_BYTES + LONGEST_UPDATE_BYTES + reply_bytes)
    }

    fn loop_in_flight(&self) -> bool {
        self.slots.in_flight().any(|(id, _)| id == id::LOOP)
    }

    fn write(&mut self, now: Instant, waiting: Waiting, out: &mut Vec<u8>) {
        let Request { command, reply_within, result_within } = waiting.request;
        let before = out.len();
        command.encode(out);
        let line_time = match command {
            // Its repetition is due when it is due.
            Command::FastStop => Duration::ZERO,
            _ => self.round_trip_line_time(out.len() - before, command.id()),
        };
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

    /// The device may have restarted: the results of accepted motions come within [`RESULT_GRACE`], or never.
    pub fn expect_results(&mut self, now: Instant) {
        for (id, in_flight) in self.slots.in_flight_mut() {
            if id::is_motion(id) && in_flight.accepted {
                in_flight.deadline = in_flight.deadline.min(now + RESULT_GRACE);
            }
        }
    }

    /// A stop ends what was written before it, and nothing that came after.
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
            events.push_back(Event::Ended(in_flight.token, end));
            if matches!(slot.id, id::STOP | id::FAST_STOP) {
                return false;
            }
            let closed = Closed { since: barrier.want(), echoed: false, two_step: in_flight.two_step };
            slot.state = SlotState::Closed(closed);
            true
        });
    }

    fn partial_deadline(&self) -> Option<Instant> {
        let (_, since) = self.partial?;
        let line_time = self.line_time(frame::OVERHEAD_BYTES + id::MAX_LOOP_BYTES);
        Some(since + line_time + self.config.frame_gap)
    }
}

#[cfg(test)]
mod tests;
