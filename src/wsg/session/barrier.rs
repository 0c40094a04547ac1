//! The Loop that tells late from new.
//!
//! There is no sequence number on the wire, so after a time-out a Loop with a fresh nonce is sent: what arrives
//! before its echo was on its way before it. The same Loop is the probe of a silent device.

use std::time::{Duration, Instant};

/// How long an echo may take before a Loop with another nonce is sent.
const ECHO_WITHIN: Duration = Duration::from_millis(400);

/// Marks our nonces, so that a client's Loop data are not mistaken for one.
const MARK: &[u8; 8] = b"wsg-loop";

/// Counts the Loops sent; a greater one was sent later.
pub(super) type Generation = u64;

/// Whose data a Loop has brought back.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Echo {
    /// Our newest Loop's: all that was on its way before this one was sent has arrived.
    Newest(Generation),
    /// An earlier Loop's of ours.
    Late,
    /// A client's.
    NotOurs,
}

#[derive(Debug)]
pub(super) struct Barrier {
    seed: u64,
    sent: Generation,
    wanted: bool,
    in_flight: Option<(Instant, Instant)>,
    round_trip: Option<Duration>,
}

impl Barrier {
    /// With a seed that makes its nonces differ from those of an earlier session on the same line.
    pub(super) fn new(seed: u64) -> Self {
        Self { seed, sent: 0, wanted: false, in_flight: None, round_trip: None }
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

    /// The data of the Loop that is written now.
    pub(super) fn start(&mut self, now: Instant) -> [u8; 24] {
        self.wanted = false;
        self.sent += 1;
        self.in_flight = Some((now, now + ECHO_WITHIN));
        self.nonce()
    }

    /// Takes a Loop's data.
    pub(super) fn echo(&mut self, now: Instant, data: &[u8]) -> Echo {
        match self.in_flight {
            Some((sent_at, _)) if data == self.nonce() => {
                self.in_flight = None;
                self.round_trip = Some(now.saturating_duration_since(sent_at));
                Echo::Newest(self.sent)
            }
            _ if data.starts_with(MARK) => Echo::Late,
            _ => Echo::NotOurs,
        }
    }

    pub(super) fn handle_timeout(&mut self, now: Instant) {
        if self.deadline().is_some_and(|deadline| deadline <= now) {
            self.in_flight = None;
            self.wanted = true;
        }
    }

    pub(super) fn deadline(&self) -> Option<Instant> {
        self.in_flight.map(|(_, deadline)| deadline)
    }

    /// How long the newest echo took.
    pub(super) fn round_trip(&self) -> Option<Duration> {
        self.round_trip
    }

    fn nonce(&self) -> [u8; 24] {
        let mut nonce = [0; 24];
        nonce[..8].copy_from_slice(MARK);
        nonce[8..16].copy_from_slice(&self.seed.to_le_bytes());
        nonce[16..].copy_from_slice(&self.sent.to_le_bytes());
        nonce
    }
}
