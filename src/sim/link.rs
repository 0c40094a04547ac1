//! The link's end on the device: connections, bytes in, bytes out (`fw4-en 1.1`, `1.4`).

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::wsg::{Decoded, Decoder, Status, id};

use super::config::BadChecksum;
use super::faults::{FaultKind, FaultName, Stage};
use super::received::ReceivedFrame;
use super::{Device, wire};

/// How long a frame waits for another one to leave with, where a fault wants them together.
const JOIN_WAIT: Duration = Duration::from_millis(50);

/// What the device is connected by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Interface {
    /// The only one that has connections.
    Tcp,
    /// Datagrams.
    Udp,
    /// RS-232.
    Serial,
    /// CAN.
    Can,
}

/// What has to be done to the connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkAction {
    /// Close it now, once what [`Device::poll_transmit`] gave is written.
    Drop,
}

impl Device {
    /// A client connects, or the bytes of one begin to come. A connection that was open before ends.
    ///
    /// Returns whether the device takes it; a TCP connection that it doesn't take is to be closed.
    pub fn connect(&mut self, now: Instant, interface: Interface) -> bool {
        self.advance(now);
        if interface == Interface::Tcp && !self.accepts_connections() {
            self.faults.counts.add(FaultName::RefusedConnection);
            return false;
        }
        if self.is_tcp() {
            self.end_connection();
        }
        self.link = Some(interface);
        self.connection += 1;
        (self.announced, self.is_cut, self.half_open, self.muted) = (false, false, false, false);
        self.decoder = Decoder::new(id::max_request_bytes, self.config.checksum_evaluation);
        self.partial_until = None;
        self.settle();
        true
    }

    /// The connection has ended: on TCP a FAST STOP, unless it was announced (`fw4-en 3.1.2`), or the device is told
    /// otherwise (`fw4-en 1.4.2`). On the other interfaces there is nothing that could end.
    pub fn disconnect(&mut self, now: Instant) {
        self.advance(now);
        if self.is_tcp() && !self.half_open {
            self.end_connection();
        }
        self.settle();
    }

    /// Bytes arrive.
    pub fn receive(&mut self, now: Instant, bytes: &[u8]) {
        self.advance(now);
        self.count_if(self.half_open, FaultName::HalfOpen);
        if self.link.is_none() || self.half_open || self.is_cut || self.booting_until.is_some() {
            return;
        }
        self.decoder.push(bytes);
        self.take_requests();
        self.settle();
    }

    /// Appends what is to be sent next to `out`, in one write: a frame, or what a fault made of one. `false` where
    /// nothing waits.
    pub fn poll_transmit(&mut self, out: &mut Vec<u8>) -> bool {
        if self.half_open || self.is_cut {
            return false;
        }
        if let Some(chunk) = self.chunks.pop_front() {
            out.extend_from_slice(&chunk);
            return true;
        }
        if self.waits_to_join() {
            return false;
        }
        let Some(frame) = self.outbox.pop() else { return false };
        if self.faults.is_armed(frame.id, Stage::Join)
            && let Some(next) = self.outbox.pop()
        {
            self.faults.take(frame.id, Stage::Join);
            out.extend_from_slice(&frame.bytes);
            out.extend_from_slice(&next.bytes);
            return true;
        }
        match self.faults.take(frame.id, Stage::Wire) {
            None => out.extend_from_slice(&frame.bytes),
            Some(FaultKind::DropConnection) => {
                self.cut_connection();
                return false;
            }
            Some(kind) => {
                self.chunks.extend(wire::damage(kind, frame.bytes));
                if kind == FaultKind::HalfFrame {
                    self.muted = true;
                    self.outbox.clear();
                }
                return self.poll_transmit(out);
            }
        }
        true
    }

    /// What has to be done to the connection. Ask after [`Device::poll_transmit`] has nothing more.
    pub fn poll_link(&mut self) -> Option<LinkAction> {
        self.link_actions.pop_front()
    }

    pub(super) fn is_tcp(&self) -> bool {
        self.link == Some(Interface::Tcp)
    }

    /// Until when a frame waits for another one.
    pub(super) fn join_wait(&self) -> Option<Instant> {
        let frame = self.outbox.front().filter(|_| self.outbox.len() == 1)?;
        let until = frame.at + JOIN_WAIT;
        (self.faults.is_armed(frame.id, Stage::Join) && self.clock < until).then_some(until)
    }

    fn waits_to_join(&self) -> bool {
        self.join_wait().is_some()
    }

    /// What belongs to a connection ends with it. That a half-open one has ended is not noticed.
    fn end_connection(&mut self) {
        if !self.announced && !self.half_open && self.config.fast_stop_on_disconnect {
            self.fast_stop();
        }
        self.link = None;
        self.forget_session();
    }

    pub(super) fn forget_session(&mut self) {
        self.connection += 1;
        (self.announced, self.is_cut, self.half_open) = (false, false, false);
        self.subscriptions.clear();
        self.outbox.clear();
        self.chunks.clear();
        self.late.clear();
        self.decoder = Decoder::new(id::max_request_bytes, self.config.checksum_evaluation);
        self.partial_until = None;
    }

    /// The rest of a request doesn't come any more.
    pub(super) fn give_up_partial_request(&mut self) {
        self.decoder.give_up_partial();
        self.take_requests();
    }

    fn take_requests(&mut self) {
        while let Some(decoded) = self.decoder.next() {
            match decoded {
                Decoded::Frame(frame) => {
                    let frame = ReceivedFrame { at: self.clock, id: frame.id, payload: frame.payload.to_vec() };
                    self.log.push(frame.clone());
                    self.request(frame.id, &frame.payload);
                }
                Decoded::Damaged { id } => {
                    self.damaged_requests += 1;
                    if self.config.bad_checksum == BadChecksum::Answer {
                        self.answer_status(id, Status::E_CHECKSUM_ERROR);
                    }
                }
            }
        }
        let until = self.clock + self.config.partial_request_timeout;
        self.partial_until = self.decoder.is_partial().then_some(until);
    }
}

#[cfg(test)]
#[path = "link_tests.rs"]
mod tests;
