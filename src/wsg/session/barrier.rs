//! The Loop that separates late replies from new ones.
//!
//! The wire has no sequence numbers, so after a timeout the session sends a Loop with a fresh nonce. Replies that
//! arrive before its echo were sent before it. The same Loop probes a silent device.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Initial time limit for an echo before the next Loop is sent. Doubles with each missing echo.
const ECHO_WITHIN: Duration = Duration::from_millis(400);

/// Upper bound for the doubled time limit.
const ECHO_WITHIN_AT_MOST: Duration = Duration::from_millis(1600);

/// Prefix of the session's nonces, so that a client's Loop data are not mistaken for one.
const MARK: &[u8; 8] = b"wsg-loop";

/// Size in bytes of mark, seed and generation.
pub(super) const NONCE_BYTES: usize = 24;

/// Number of a Loop, increasing in sending order.
pub(super) type LoopGeneration = u64;

/// Origin of echoed Loop data.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Echo {
    /// A Loop of this session, possibly not the newest. All replies sent before this Loop have arrived.
    Ours(LoopGeneration),
    /// A Loop of an earlier session.
    Stale,
    /// A client's Loop.
    NotOurs,
}

/// Loops without an echo after which a device that has never answered one counts as deaf.
const DEAF_AFTER: u32 = 3;

/// Newest Loops whose time is kept, to measure a round trip that is longer than the limit for an echo.
const TIMED_LOOPS: usize = 8;

#[derive(Debug)]
pub(super) struct Barrier {
    seed: u64,
    sent: LoopGeneration,
    wanted: bool,
    /// Time limit for the echo of the newest Loop, while it is awaited.
    in_flight: Option<Instant>,
    /// The newest Loops without an echo, each with the time at which it was handed out.
    sent_at: VecDeque<(LoopGeneration, Instant)>,
    /// Loops in a row without an echo.
    unanswered: u32,
    has_echoed: bool,
    echo_within: Duration,
    round_trip: Option<Duration>,
}

impl Barrier {
    /// Creates a barrier. `seed` makes its nonces differ from those of earlier sessions on the same line.
    pub(super) fn new(seed: u64) -> Self {
        Self {
            seed,
            sent: 0,
            wanted: false,
            in_flight: None,
            sent_at: VecDeque::new(),
            unanswered: 0,
            has_echoed: false,
            echo_within: ECHO_WITHIN,
            round_trip: None,
        }
    }

    /// Requests a Loop written after this call. Its generation will exceed the returned one.
    pub(super) fn want(&mut self) -> LoopGeneration {
        self.wanted = true;
        self.sent
    }

    /// Requests a Loop unless one is in flight.
    pub(super) fn probe(&mut self) {
        self.wanted |= self.in_flight.is_none();
    }

    pub(super) fn is_wanted(&self) -> bool {
        self.wanted && self.in_flight.is_none()
    }

    pub(super) fn is_in_flight(&self) -> bool {
        self.in_flight.is_some()
    }

    /// Returns the data of the Loop to write now. `line_time` extends the time limit for its echo.
    pub(super) fn start(&mut self, now: Instant, line_time: Duration) -> [u8; NONCE_BYTES] {
        self.wanted = false;
        self.sent += 1;
        self.in_flight = Some(now + self.echo_within + line_time);
        if self.sent_at.len() == TIMED_LOOPS {
            self.sent_at.pop_front();
        }
        self.sent_at.push_back((self.sent, now));
        self.nonce()
    }

    /// Identifies echoed Loop data.
    pub(super) fn echo(&mut self, now: Instant, data: &[u8]) -> Echo {
        let Some((MARK, numbers)) = data.split_first_chunk() else { return Echo::NotOurs };
        let Some((seed, generation)) = numbers.split_first_chunk() else { return Echo::NotOurs };
        let Ok(generation) = generation.try_into().map(u64::from_le_bytes) else { return Echo::NotOurs };
        if u64::from_le_bytes(*seed) != self.seed || generation > self.sent {
            return Echo::Stale;
        }
        self.echo_within = ECHO_WITHIN;
        self.unanswered = 0;
        self.has_echoed = true;
        if generation == self.sent {
            self.in_flight = None;
        }
        while let Some((sent, sent_at)) = self.sent_at.pop_front_if(|(sent, _)| *sent <= generation) {
            if sent == generation {
                self.round_trip = Some(now.saturating_duration_since(sent_at));
            }
        }
        Echo::Ours(generation)
    }

    pub(super) fn handle_timeout(&mut self, now: Instant) {
        if self.deadline().is_some_and(|deadline| deadline <= now) {
            self.in_flight = None;
            self.wanted = true;
            self.unanswered = self.unanswered.saturating_add(1);
            self.echo_within = (2 * self.echo_within).min(ECHO_WITHIN_AT_MOST);
        }
    }

    pub(super) fn deadline(&self) -> Option<Instant> {
        self.in_flight
    }

    pub(super) fn has_echoed(&self) -> bool {
        self.has_echoed
    }

    pub(super) fn unanswered(&self) -> u32 {
        self.unanswered
    }

    /// Whether the device has answered none of several Loops.
    pub(super) fn is_deaf(&self) -> bool {
        !self.has_echoed && self.unanswered >= DEAF_AFTER
    }

    /// Takes the round-trip time of the newest echo; returns each only once.
    pub(super) fn take_round_trip(&mut self) -> Option<Duration> {
        self.round_trip.take()
    }

    fn nonce(&self) -> [u8; NONCE_BYTES] {
        let mut nonce = [0; NONCE_BYTES];
        nonce[..8].copy_from_slice(MARK);
        nonce[8..16].copy_from_slice(&self.seed.to_le_bytes());
        nonce[16..].copy_from_slice(&self.sent.to_le_bytes());
        nonce
    }
}
