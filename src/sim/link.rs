//! The device's side of the link: connections, received and sent bytes (`fw4-en 1.1`, `1.4`).

pub(crate) mod faults;
pub(crate) mod outbox;
pub(crate) mod received;
mod wire;

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use wsg::timed_decoder::RESYNC_PAUSE;
use wsg::{Command, Decoded, Decoder, InvalidRequest, Status, TimedDecoder, id};

use super::Device;
use super::config::{BadChecksum, DeviceConfig};
use faults::{FaultKind, FaultName, FaultStage};
use received::ReceivedFrame;

/// Time limit for a frame that waits to be joined with the next one.
const JOIN_WAIT: Duration = Duration::from_millis(50);

/// Interface of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Interface {
    /// TCP, the only interface with connections.
    Tcp,
    Udp,
    /// RS-232.
    Serial,
    Can,
}

/// Action that the caller must perform on the connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkAction {
    /// Close the connection after writing all bytes from [`Device::poll_transmit`].
    Drop,
}

impl Device {
    /// Connects a client on `interface`. An open TCP connection ends.
    ///
    /// Returns whether the device accepts the client. Close a TCP connection that it rejects.
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
        self.decoder = request_decoder(&self.config);
        self.settle();
        true
    }

    /// Ends the connection. On TCP, this triggers a FAST STOP unless the end was announced (`fw4-en 3.1.2`) or the
    /// device is configured otherwise (`fw4-en 1.4.2`). Other interfaces have no connections.
    pub fn disconnect(&mut self, now: Instant) {
        self.advance(now);
        if self.is_tcp() && !self.half_open {
            self.end_connection();
        }
        self.settle();
    }

    /// Processes received bytes.
    pub fn receive(&mut self, now: Instant, bytes: &[u8]) {
        self.advance(now);
        self.count_if(self.half_open, FaultName::HalfOpen);
        if self.link.is_none() || self.half_open || self.is_cut || self.booting_until.is_some() {
            return;
        }
        self.decoder.push(self.clock, bytes);
        self.take_requests();
        self.settle();
    }

    /// Appends the bytes of the next write to `out`: a frame, or its bytes after a fault. Returns `false` if none wait.
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
        if self.faults.is_armed(frame.id, FaultStage::Join)
            && let Some(next) = self.outbox.pop()
        {
            self.faults.take(frame.id, FaultStage::Join);
            out.extend_from_slice(&frame.bytes);
            out.extend_from_slice(&next.bytes);
            return true;
        }
        match self.faults.take(frame.id, FaultStage::Wire) {
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

    /// Returns the next action on the connection. Call it after [`Device::poll_transmit`] returns `false`.
    pub fn poll_link(&mut self) -> Option<LinkAction> {
        self.link_actions.pop_front()
    }

    pub(super) fn is_tcp(&self) -> bool {
        self.link == Some(Interface::Tcp)
    }

    /// Time until which a frame waits to be joined.
    pub(super) fn join_wait(&self) -> Option<Instant> {
        let frame = self.outbox.front().filter(|_| self.outbox.len() == 1)?;
        let until = frame.at + JOIN_WAIT;
        (self.faults.is_armed(frame.id, FaultStage::Join) && self.clock < until).then_some(until)
    }

    fn waits_to_join(&self) -> bool {
        self.join_wait().is_some()
    }

    /// Ends the connection, with a FAST STOP if so configured. The device does not notice the end of a half-open one.
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
        self.steering.clear();
        self.decoder = request_decoder(&self.config);
    }

    /// Gives up a request whose rest is overdue.
    pub(super) fn give_up_overdue_request(&mut self) {
        self.decoder.handle_timeout(self.clock);
        self.take_requests();
    }

    fn take_requests(&mut self) {
        while let Some(decoded) = self.decoder.next() {
            match decoded {
                Decoded::Frame(frame) => {
                    let id = frame.id;
                    let payload = frame.payload.to_vec();
                    let command = Command::parse(id, &payload);
                    self.take_request(id, payload, command);
                }
                Decoded::TooLong { id, payload_bytes } => {
                    self.take_request(id, Vec::new(), Command::parse_too_long(id, payload_bytes));
                }
                Decoded::MissedFastStop => self.take_request(id::FAST_STOP, Vec::new(), Ok(Command::FastStop)),
                Decoded::Damaged { id } => {
                    self.damaged_requests += 1;
                    if self.config.bad_checksum == BadChecksum::Answer {
                        self.answer_status(id, Status::E_CHECKSUM_ERROR);
                    }
                }
            }
        }
    }

    fn take_request(&mut self, id: u8, payload: Vec<u8>, command: Result<Command, InvalidRequest>) {
        self.log.push(ReceivedFrame { at: self.clock, id, payload });
        self.request(id, command);
    }
}

/// Returns a decoder for a new connection.
pub(super) fn request_decoder(config: &DeviceConfig) -> TimedDecoder {
    let decoder = Decoder::of_requests(config.checksum_evaluation);
    TimedDecoder::new(decoder, config.partial_request_timeout, RESYNC_PAUSE)
}

#[cfg(test)]
#[path = "link_tests.rs"]
mod tests;
