//! The Loop that separates late replies from new ones.
//!
//! The wire has no sequence numbers, so after a timeout the session sends a Loop with a fresh nonce. Replies that
//! arrive before its echo were sent before it. The same Loop probes a silent device.

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

#[derive(Debug)]
pub(super) struct Barrier {
    seed: u64,
    sent: LoopGeneration,
    wanted: bool,
    in_flight: Option<(Instant, Instant)>,
    echo_within: Duration,
    round_trip: Option<Duration>,
}

impl Barrier {
    /// Creates a barrier. `seed` makes its nonces differ from those of earlier sessions on the same line.
    pub(super) fn new(seed: u64) -> Self {
        Self { seed, sent: 0, wanted: false, in_flight: None, echo_within: ECHO_WITHIN, round_trip: None }
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
        self.in_flight = Some((now, now + self.echo_within + line_time));
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
        if generation == self.sent
            && let Some((sent_at, _)) = self.in_flight.take()
        {
            self.round_trip = Some(now.saturating_duration_since(sent_at));
        }
        Echo::Ours(generation)
    }

    pub(super) fn handle_timeout(&mut self, now: Instant) {
        if self.deadline().is_some_and(|deadline| deadline <= now) {
            self.in_flight = None;
            self.wanted = true;
            self.echo_within = (2 * self.echo_within).min(ECHO_WITHIN_AT_MOST);
        }
    }

    pub(super) fn deadline(&self) -> Option<Instant> {
        self.in_flight.map(|(_, deadline)| deadline)
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
