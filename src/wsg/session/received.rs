//! Handling of received frames: matching replies to requests.

use std::time::Instant;

use super::barrier::Echo;
use super::slots::{Closed, SlotState, Verdict};
use super::{DUPLICATE_WITHIN, End, NoValue, Session, SessionEvent};
use crate::decoder::Decoded;
use crate::frame::{Frame, HEADER_BYTES, OVERHEAD_BYTES};
use crate::reply::{Data, InvalidReply, Reply};
use crate::{Status, SystemState, id};

const CHECKSUM_BYTES: usize = OVERHEAD_BYTES - HEADER_BYTES;

/// Whether a frame is the newest one written, sent back by the line. Only a frame that is not a reply can be one: a
/// reply can happen to equal its request.
fn is_echo(written: &[u8], frame: Frame<'_>) -> bool {
    written.split_at_checked(HEADER_BYTES).is_some_and(|(header, rest)| {
        header[3] == frame.id && rest.len() == frame.payload.len() + CHECKSUM_BYTES && rest.starts_with(frame.payload)
    })
}

impl Session {
    pub(super) fn decode(&mut self, now: Instant) {
        loop {
            self.expect_opaque_replies();
            let Some(decoded) = self.decoder.next() else { return };
            let (id, reply) = match decoded {
                Decoded::Frame(frame) => {
                    let reply = Reply::parse(frame.id, frame.payload);
                    if reply.is_err() && is_echo(&self.last_written, frame) {
                        self.counters.echoes += 1;
                        continue;
                    }
                    let bytes = frame.payload.len();
                    if id::is_longer_than_its_manual(frame.id, bytes) && self.long_replies.insert(frame.id) {
                        self.events.push_back(SessionEvent::LongReply(frame.id, bytes));
                    }
                    (frame.id, reply)
                }
                Decoded::TooLong { id, payload_bytes } => (id, Err(InvalidReply::Size { id, bytes: payload_bytes })),
                Decoded::Damaged { .. } | Decoded::MissedFastStop => continue,
            };
            self.last_heard = now;
            match reply {
                Ok(reply) => self.take_reply(now, id, reply),
                Err(invalid) => self.take_invalid(now, id, invalid),
            }
        }
    }

    /// Tells the decoder which replies can contain frames. A header of such an id is damage unless its reply is
    /// expected.
    pub(super) fn expect_opaque_replies(&mut self) {
        self.decoder.expect_opaque(self.slots.ids().filter(|id| id::has_opaque_replies(*id)));
    }

    fn take_reply(&mut self, now: Instant, id: u8, reply: Reply) {
        if id == id::LOOP && self.take_echo(now, &reply) {
            return;
        }
        if id::has_updates(id) {
            match &reply {
                Reply::Success(data) => self.take_update(data.clone()),
                // These say nothing about the value.
                Reply::Status(Status::E_CMD_PENDING | Status::E_CHECKSUM_ERROR) => {}
                Reply::Status(status) => self.events.push_back(SessionEvent::NoValue(id, NoValue::Refused(*status))),
            }
        }
        let Some(slot) = self.slots.get_mut(id) else {
            // Automatic updates are not stray replies.
            if !id::has_updates(id) {
                self.counters.stray_replies += 1;
                self.repeated.insert(id);
            }
            return;
        };
        match &mut slot.state {
            SlotState::InFlight(in_flight) if in_flight.is_foreign_echo(&reply) => self.counters.late_replies += 1,
            SlotState::InFlight(in_flight) => match in_flight.judge(id, reply.status()) {
                Verdict::Accepted => {
                    self.round_trip = Some(now.saturating_duration_since(in_flight.sent_at));
                    in_flight.accepted = true;
                    if !matches!(id, id::STOP | id::FAST_STOP) {
                        // Acceptance must not delay the repetition of a FAST STOP, or the next Stop.
                        in_flight.deadline = now + in_flight.result_within;
                    }
                    self.events.push_back(SessionEvent::Accepted(in_flight.token));
                }
                Verdict::Final => {
                    let token = in_flight.token;
                    let order = in_flight.order;
                    if !in_flight.accepted {
                        self.round_trip = Some(now.saturating_duration_since(in_flight.sent_at));
                    }
                    self.open_or_await_duplicates(now, id);
                    if matches!(id, id::STOP | id::FAST_STOP) && reply.status() == Status::E_SUCCESS {
                        self.expect_aborts_before(now, order);
                    }
                    self.events.push_back(SessionEvent::Ended(token, End::Reply(reply)));
                }
                Verdict::Late => self.counters.late_replies += 1,
            },
            SlotState::Closed(closed) => {
                self.counters.late_replies += 1;
                // This is the late result itself.
                if closed.awaits_result() && reply.status() != Status::E_CMD_PENDING {
                    self.open_or_await_duplicates(now, id);
                }
            }
        }
    }

    /// Ends the wait of an id whose request got its last reply.
    fn open_or_await_duplicates(&mut self, now: Instant, id: u8) {
        // A device without Loop separates nothing: only the time limit for duplicates remains.
        let is_deaf = self.barrier.is_deaf();
        let repeats = self.config.may_duplicate || self.repeated.contains(&id) && !is_deaf;
        // Behind a power-up, the next reply belongs to the Off that ended it.
        let may_be_repeated = repeats && !self.slots.has_several(id);
        match self.slots.get_mut(id) {
            Some(slot) if may_be_repeated && !matches!(id, id::STOP | id::FAST_STOP) && !id::has_updates(id) => {
                let duplicate_until = self.config.may_duplicate.then(|| now + DUPLICATE_WITHIN);
                slot.state = SlotState::Closed(Closed {
                    duplicate_until,
                    echoed: is_deaf,
                    ..Closed::until_echo(now, self.barrier.want())
                });
            }
            _ => self.slots.open(id),
        }
    }

    /// Handles a reply to the session's own Loop. Returns whether it was one.
    fn take_echo(&mut self, now: Instant, reply: &Reply) -> bool {
        let Reply::Success(Data::Loop(data)) = reply else {
            // `E_CMD_PENDING` before the data (`fw4-en 3.1.1`), or an error; the deadline handles both.
            return self.barrier.is_in_flight() && !self.loop_in_flight();
        };
        // A late reply and its duplicates can be overtaken, too.
        let late_until = self.config.may_duplicate.then(|| now + DUPLICATE_WITHIN);
        match self.barrier.echo(now, data) {
            Echo::Ours(generation) => self.slots.retain(|slot| match &mut slot.state {
                SlotState::Closed(closed) if closed.since < generation && closed.script_until.is_none() => {
                    closed.echoed = true;
                    closed.duplicate_until = closed.duplicate_until.or(late_until);
                    closed.two_step || closed.duplicate_until.is_some_and(|until| now < until)
                }
                _ => true,
            }),
            Echo::Stale => self.counters.late_replies += 1,
            Echo::NotOurs => return false,
        }
        true
    }

    fn take_update(&mut self, data: Data) {
        if let Data::SystemState(flags) = data {
            self.moving = flags.contains(SystemState::MOVING);
            if !self.moving {
                self.slots.retain(
                    |slot| !matches!(&slot.state, SlotState::Closed(closed) if closed.echoed && closed.two_step),
                );
            }
        }
        self.events.push_back(SessionEvent::Update(data));
    }

    /// Shortens the wait for the results of running motions to [`super::ABORT_GRACE`], because the device has stopped.
    pub fn expect_aborts(&mut self, now: Instant) {
        self.expect_aborts_before(now, u64::MAX);
    }

    fn take_invalid(&mut self, now: Instant, id: u8, invalid: InvalidReply) {
        self.counters.invalid_replies += 1;
        if id::has_updates(id) {
            self.events.push_back(SessionEvent::NoValue(id, NoValue::Invalid(invalid)));
        }
        if id::is_motion(id) {
            // The fingers may be moving, so the request stays in flight until its deadline.
            return;
        }
        if let Some(slot) = self.slots.get_mut(id)
            && let SlotState::InFlight(in_flight) = &slot.state
        {
            let token = in_flight.token;
            self.open_or_await_duplicates(now, id);
            self.events.push_back(SessionEvent::Ended(token, End::Invalid(invalid)));
        }
    }
}
