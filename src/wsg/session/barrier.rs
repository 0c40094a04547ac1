//! The Loop that tells late from new.
//!
//! There is no sequence number on the wire, so after a time-out a Loop with a fresh nonce is sent: what arrives
//! before its echo was on its way before it. The same Loop is the probe of a silent device.

use std::time::{Duration, Instant};

/// How long an echo may take at first before a Loop with another nonce is sent; it doubles with each that isn't heard.
const ECHO_WITHIN: Duration = Duration::from_millis(400);

/// And at last.
const ECHO_WITHIN_AT_MOST: Duration = Duration::from_millis(1600);

/// Marks our nonces, so that a client's Loop data are not mistaken for one.
const MARK: &[u8; 8] = b"wsg-loop";

/// The mark, the seed, and the generation.
pub(super) const NONCE_BYTES: usize = 24;

/// Counts the Loops sent; a greater one was sent later.
pub(super) type Generation = u64;

/// Whose data a Loop has brought back.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Echo {
    /// A Loop's of ours, if not the newest one's: all that was on its way before that one was sent has arrived.
    Ours(Generation),
    /// Of a Loop that was sent before this session.
    Stale,
    /// A client's.
    NotOurs,
}

#[derive(Debug)]
pub(super) struct Barrier {
    seed: u64,
    sent: Generation,
    wanted: bool,
    in_flight: Option<(Instant, Instant)>,
    echo_within: Duration,
    round_trip: Option<Duration>,
}

impl Barrier {
    /// With a seed that makes its nonces differ from those of an earlier session on the same line.
    pub(super) fn new(seed: u64) -> Self {
        Self { seed, sent: 0, wanted: false, in_flight: None, echo_within: ECHO_WITHIN, round_trip: None }
    }

    /// Asks for a Loop that is written from now on. Returns the generation that its echo will be greater than.
    pub(super) fn want(&mut self) -> Generation {
        self.wanted = true;
        self.sent
    }

    /// Asks for a Loop unless one is on its way.
    pub(super) fn probe(&mut self) {
        self.wanted |= self.in_flight.is_none();
    }

    pub(super) fn is_wanted(&self) -> bool {
        self.wanted && self.in_flight.is_none()
    }

    pub(super) fn is_in_flight(&self) -> bool {
        self.in_flight.is_some()
    }

    /// The data of the Loop that is written now, and whose way takes so much line time.
    pub(super) fn start(&mut self, now: Instant, line_time: Duration) -> [u8; NONCE_BYTES] {
        self.wanted = false;
        self.sent += 1;
        self.in_flight = Some((now, now + self.echo_within + line_time));
        self.nonce()
    }

    /// Takes a Loop's data.
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

    /// How long the newest echo took, once.
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
