//! Bytes in transit between the gateway and the device.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Maximum time between a datagram and its duplicate, and maximum reordering.
pub const AGAIN_WITHIN: Duration = Duration::from_millis(3);

/// One direction of the wire, in order, with a delay.
#[derive(Default)]
pub struct Wire(pub VecDeque<(Instant, Vec<u8>)>);

impl Wire {
    pub fn send(&mut self, at: Instant, bytes: Vec<u8>) {
        // A wire keeps the order.
        let at = self.0.back().map_or(at, |(last, _)| at.max(*last));
        self.0.push_back((at, bytes));
    }

    /// Sends a datagram, which can overtake others.
    pub fn send_datagram(&mut self, at: Instant, bytes: Vec<u8>) {
        // Reordering is limited: without sequence numbers, no protocol survives datagrams that are seconds out of
        // order.
        let last = self.0.back().map_or(at, |(last, _)| *last);
        let at = at.max(last.checked_sub(AGAIN_WITHIN).unwrap_or(last));
        let index = self.0.partition_point(|(other, _)| *other <= at);
        self.0.insert(index, (at, bytes));
    }

    pub fn due(&self) -> Option<Instant> {
        self.0.front().map(|(at, _)| *at)
    }

    pub fn take(&mut self, now: Instant) -> Option<Vec<u8>> {
        (self.due()? <= now).then(|| self.0.pop_front().map(|(_, bytes)| bytes))?
    }
}
