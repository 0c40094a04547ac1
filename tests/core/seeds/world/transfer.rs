//! Effects of the wire on the bytes between gateway and device.

use std::time::{Duration, Instant};

use gripper::actor::Close;
use rand::RngExt;
use sim::{Interface, LinkAction};
use wsg::{Command, id};

use super::World;
use crate::seeds::invariants::Invariants;
use crate::seeds::servo::Servos;
use crate::seeds::wire;

impl World {
    pub(super) fn move_to_device(&mut self) {
        let mut frame = Vec::new();
        while self.connected {
            if let Some(close) = self.actor.wants_close() {
                self.close(close);
                return;
            }
            if self.busy_until.is_some() {
                return;
            }
            frame.clear();
            let now = self.clock();
            if !self.actor.poll_transmit(now, &mut frame) {
                return;
            }
            self.count_step();
            Invariants::sent(self, &frame);
            let line_time = self.bytes_per_second.map(|rate| Duration::from_secs(1) * frame.len() as u32 / rate);
            self.busy_until = line_time.map(|time| self.now + time);
            let at = self.now + self.delay() + line_time.unwrap_or_default();
            let at = at.max(self.requests_stalled_until.unwrap_or(at));
            let damaged = self.noisy && self.rng.random_bool(0.003);
            self.count("wire: request damaged", damaged);
            if damaged {
                let index = self.rng.random_range(0..frame.len());
                frame[index] ^= 1 << self.rng.random_range(0..8);
            }
            if self.interface == Interface::Udp {
                self.keep_old_datagram(0, &frame);
                for at in self.arrivals("request", at) {
                    self.to_device.send_datagram(at, frame.clone());
                }
            } else {
                self.to_device.send(at, frame.clone());
            }
        }
    }

    pub(super) fn move_to_gateway(&mut self) {
        let mut chunk = Vec::new();
        while self.device.poll_transmit(&mut chunk) {
            let bytes = std::mem::take(&mut chunk);
            if self.interface != Interface::Udp {
                self.invariants.replied(self.now, &bytes);
            }
            self.send_to_gateway(bytes);
        }
        while let Some(LinkAction::Drop) = self.device.poll_link() {
            self.note("the device drops the connection");
            self.disconnected("dropped by the device");
        }
    }

    fn send_to_gateway(&mut self, mut bytes: Vec<u8>) {
        if !self.connected {
            return;
        }
        let at = (self.now + self.delay()).max(self.stalled_until.unwrap_or(self.now));
        if !self.noisy {
            return self.to_gateway.send(at, bytes);
        }
        if self.interface == Interface::Udp {
            self.keep_old_datagram(1, &bytes);
            for at in self.arrivals("reply", at) {
                self.to_gateway.send_datagram(at, bytes.clone());
            }
            return;
        }
        let [damaged, split, garbage] = [0.002, 0.02, 0.002].map(|chance| self.rng.random_bool(chance));
        self.count("wire: reply damaged", damaged);
        self.count("wire: reply split at every byte", split);
        self.count("wire: garbage between frames", garbage);
        if damaged {
            let index = self.rng.random_range(0..bytes.len());
            bytes[index] ^= 1 << self.rng.random_range(0..8);
        }
        if garbage {
            let noise = (0..self.rng.random_range(1..30)).map(|_| self.rng.random()).collect();
            self.to_gateway.send(at, noise);
        }
        if split {
            for byte in bytes {
                self.to_gateway.send(at, vec![byte]);
            }
        } else {
            self.to_gateway.send(at, bytes);
        }
    }

    /// Returns arrival times of a datagram: one, none or two.
    fn arrivals(&mut self, what: &str, at: Instant) -> Vec<Instant> {
        let [lost, twice] = [0.003, 0.01].map(|chance| self.noisy && self.rng.random_bool(chance));
        self.count(&format!("wire: {what} datagram lost"), lost);
        self.count(&format!("wire: {what} datagram duplicated"), twice);
        let again = at + Duration::from_micros(self.rng.random_range(0..wire::AGAIN_WITHIN.as_micros() as u64));
        match (lost, twice) {
            (true, _) => Vec::new(),
            (false, true) => vec![at, again],
            (false, false) => vec![at],
        }
    }

    fn delay(&mut self) -> Duration {
        Duration::from_micros(self.rng.random_range(50..self.longest_delay.as_micros() as u64))
    }

    /// Delivers a datagram of each direction once more, long after it was sent.
    pub(super) fn deliver_late_datagrams(&mut self) {
        if self.interface != Interface::Udp || !self.connected {
            return;
        }
        let [request, reply] = self.old_datagrams.clone();
        self.count("wire: late datagrams", !request.is_empty() && !reply.is_empty());
        self.note(&format!("late {} and {}", hex::encode(&request), hex::encode(&reply)));
        if !request.is_empty() {
            self.device.receive(self.now, &request);
        }
        if !reply.is_empty() {
            let now = self.clock();
            self.invariants.heard(self.now, &reply);
            self.actor.receive(now, &reply);
        }
    }

    /// Keeps a datagram now and then, to be delivered late. Requests that move the fingers are kept by the wire alone:
    /// no gateway can tell a late one from a new one.
    fn keep_old_datagram(&mut self, direction: usize, bytes: &[u8]) {
        let moves = direction == 0 && bytes.get(3).is_some_and(|id| id::is_motion_or_script(*id));
        if !moves && self.rng.random_bool(0.02) {
            self.old_datagrams[direction] = bytes.to_vec();
        }
    }

    /// Closes the link as the driver does when the actor asks for it.
    fn close(&mut self, close: Close) {
        self.note(&format!("closing: {close}"));
        if close != Close::Drained && self.interface == Interface::Tcp {
            let mut farewell = Vec::new();
            Command::DisconnectAnnouncement.encode(&mut farewell);
            self.flush_to_device();
            self.device.receive(self.now, &farewell);
        }
        self.disconnected(&close.to_string());
    }

    fn flush_to_device(&mut self) {
        while let Some((_, bytes)) = self.to_device.0.pop_front() {
            self.device_receives(&bytes);
        }
    }

    /// Ends the connection. Bytes in transit may still arrive.
    pub fn disconnected(&mut self, cause: &str) {
        if !self.connected {
            return;
        }
        self.connected = false;
        if self.rng.random_bool(0.5) {
            self.flush_to_device();
        }
        self.to_device.0.clear();
        self.to_gateway.0.clear();
        self.device.disconnect(self.now);
        let now = self.clock();
        self.actor.link_down(now, cause);
        Servos::disconnected(self);
        if !self.actor.is_draining() {
            self.reconnect_at = Some(self.now + Duration::from_millis(100));
        }
    }
}
