//! One client's virtual device, sans-IO: takes bytes, replies and `now`; produces frames and orders for the gripper.
//!
//! # Inputs and outputs
//!
//! - Inputs: [`VirtualDevice::receive`], [`VirtualDevice::answer`], [`VirtualDevice::handle_timeout`]. Each takes the
//!   newest state, which queries and automatic updates are served from.
//! - Outputs, to be drained after each input: [`VirtualDevice::poll_order`], [`VirtualDevice::poll_refused`];
//!   [`VirtualDevice::poll_frame`] whenever the client can take one; [`VirtualDevice::poll_timeout`].
//!
//! Requests are executed in order, each after the previous one was answered; only Stop and FAST STOP overtake. Slow
//! requests (an accepted motion, a Stop, a script) do not block later ones. The exception is a motion after a Stop,
//! which waits, since many clients send a Stop and a motion together.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

mod queries;
use super::acknowledge::AcknowledgeRight;
use super::input::{PortInput, Unusable};
use super::order::{PortOrder, PortOrdered, PortReply, PortRequest};
use super::port::{AcknowledgePolicy, Rules};
use super::refusals::{Cause, Refused};
use crate::gripper::FastStop;
use crate::model::{Action, CustomIds, FastStopId, Link, State};
use crate::wsg::{ChecksumEvaluation, Command, Data, Reply, Status, Subscriptions, Updates, id};

/// Maximum number of waiting requests of one client. More are answered with E_OVERRUN.
pub(super) const MAX_WAITING_REQUESTS: usize = 64;

/// Maximum number of unanswered Stops of one client. More are answered with E_OVERRUN: all but one of the accepted
/// Stops are written after anything that a further Stop could end.
pub(super) const MAX_STOPS: usize = 16;

/// Maximum number of unread frames of a client. A client that exceeds it no longer reads and is disconnected.
pub(super) const MAX_WAITING_FRAMES: usize = 256;

/// Smallest `fault_code` of a fault that the device shows without a FAST STOP.
const MIN_DEVICE_FAULT: u16 = 20;

/// The FAST STOPs of one client. All that arrive while one is unanswered are combined into one more. Any number of FAST
/// STOPs therefore costs two at most, and none is lost if the first is acknowledged meanwhile.
#[derive(Debug, Default)]
struct FastStops {
    /// Number of requests that the running FAST STOP answers; 0 if none is running.
    under_way: usize,
    waiting: usize,
}

/// A request that waits for its turn.
#[derive(Debug)]
struct WaitingRequest {
    id: u8,
    command: Result<Command, Unusable>,
    /// The FAST STOP that was latched when the request arrived. A later one withdraws a motion.
    latched: Option<FastStopId>,
    /// Whether a FAST STOP of the same client had arrived before, and was unanswered.
    is_behind_fast_stop: bool,
    /// Number of requests of a stream that this one has overtaken.
    overtaken: usize,
}

#[derive(Debug)]
#[allow(clippy::struct_excessive_bools, reason = "facts that are independent")]
pub(super) struct VirtualDevice {
    custom_ids: Arc<CustomIds>,
    shortest_period_ms: u16,
    input: PortInput,
    waiting: VecDeque<WaitingRequest>,
    /// Number of replies that the next request waits for.
    awaited: usize,
    stops: usize,
    /// Number of motions that have not ended. A Stop ends motions, but not scripts.
    motions: usize,
    /// Whether a Stop arrived during a motion of this client that has not ended yet.
    motions_are_stopping: bool,
    fast_stops: FastStops,
    subscriptions: Subscriptions,
    orders: VecDeque<PortOrdered>,
    refused: VecDeque<Refused>,
    frames: VecDeque<Vec<u8>>,
    announced: bool,
    overflown: bool,
    acknowledges: AcknowledgeRight,
    /// Whether the last request of this client ended with an error.
    has_failed: bool,
    /// Time at which the device answered the last change that this client knows of. The client sees no older value.
    changed_at: Option<Instant>,
    /// Updates that go with the query under way, whose value is being measured.
    measured_updates: Updates,
}

impl VirtualDevice {
    /// Returns the device of a client. The period of its automatic updates is at least `shortest_period_ms`.
    pub(super) fn new(subject: Arc<str>, rules: &Rules, custom_ids: Arc<CustomIds>, shortest_period_ms: u16) -> Self {
        Self {
            input: PortInput::new(if rules.checksum_evaluation {
                ChecksumEvaluation::On
            } else {
                ChecksumEvaluation::Off
            }),
            custom_ids,
            shortest_period_ms,
            waiting: VecDeque::new(),
            awaited: 0,
            stops: 0,
            motions: 0,
            motions_are_stopping: false,
            fast_stops: FastStops::default(),
            subscriptions: Subscriptions::spread(),
            orders: VecDeque::new(),
            refused: VecDeque::new(),
            frames: VecDeque::new(),
            announced: false,
            overflown: false,
            acknowledges: AcknowledgeRight::new(subject, rules.acknowledge == AcknowledgePolicy::Any),
            has_failed: false,
            changed_at: None,
            measured_updates: Updates::Off,
        }
    }

    pub(super) fn receive(&mut self, now: Instant, bytes: &[u8], state: &State) {
        self.input.push(now, bytes);
        self.take_requests(now, state);
    }

    /// Notes the end of a datagram, in which every frame is complete.
    pub(super) fn end_datagram(&mut self, now: Instant, state: &State) {
        self.input.end_datagram();
        self.take_requests(now, state);
    }

    pub(super) fn handle_timeout(&mut self, now: Instant, state: &State) {
        self.input.handle_timeout(now);
        self.take_requests(now, state);
        self.take_up(now, state);
        self.send_updates(now, state);
    }

    /// Handles the gripper's reply to an order.
    pub(super) fn answer(&mut self, now: Instant, ask: PortRequest, answer: PortReply, state: &State) {
        let is_last = answer != PortReply::Accepted;
        if self.is_change(ask.id) {
            self.changed_at = state.values.changed_at;
        }
        match answer {
            PortReply::Accepted => self.status_of_all(ask.id, Status::E_CMD_PENDING, ask.overtaken),
            PortReply::Reply(Reply::Success(_)) if id::has_updates(ask.id) => self.measured(now, ask.id, state),
            PortReply::Reply(reply) => {
                for _ in 0..=ask.overtaken {
                    self.reply(ask.id, &reply);
                }
            }
            PortReply::Refused(refusal) => {
                if let Some(id) = refusal.fast_stop {
                    self.acknowledges.saw(id);
                }
                self.status_of_all(ask.id, refusal.status, ask.overtaken);
            }
            PortReply::NoFault if state.latch.is_some() => self.acknowledge(state),
            PortReply::NoFault => self.reply(ask.id, &Reply::Success(Data::None)),
            PortReply::FastStopped(FastStop { id, confirmed }) => {
                self.acknowledges.caused(id);
                for request in self.waiting.iter_mut().filter(|request| request.is_behind_fast_stop) {
                    (request.latched, request.is_behind_fast_stop) = (Some(id), false);
                }
                for _ in 0..std::mem::take(&mut self.fast_stops.under_way) {
                    self.status(ask.id, if confirmed { Status::E_SUCCESS } else { Status::E_TIMEOUT });
                }
                self.begin_fast_stop();
            }
        }
        if ask.id == id::STOP && is_last {
            self.stops = self.stops.saturating_sub(1);
        }
        if id::is_motion(ask.id) && is_last {
            self.motions = self.motions.saturating_sub(1);
            self.motions_are_stopping &= self.motions > 0;
        }
        if ask.is_awaited {
            self.awaited = self.awaited.saturating_sub(1);
        }
        self.take_up(now, state);
    }

    /// Notes whether this client holds the lease.
    pub(super) fn set_holder(&mut self, holds_lease: bool) {
        self.acknowledges.set_holder(holds_lease);
    }

    pub(super) fn poll_order(&mut self) -> Option<PortOrdered> {
        self.orders.pop_front()
    }

    pub(super) fn poll_refused(&mut self) -> Option<Refused> {
        self.refused.pop_front()
    }

    pub(super) fn poll_frame(&mut self) -> Option<Vec<u8>> {
        self.frames.pop_front()
    }

    pub(super) fn poll_timeout(&self, now: Instant, state: &State) -> Option<Instant> {
        self.input.deadline().into_iter().chain(self.next_update(now, state)).min()
    }

    /// Whether every new state matters: for updates on change, or because a motion waits, which a FAST STOP withdraws.
    pub(super) fn watches(&self) -> bool {
        self.subscriptions.has_on_change() || self.waiting.iter().any(|request| self.moves(request.id))
    }

    /// Whether the client has announced its disconnect, including in a waiting request.
    pub(super) fn has_announced(&self) -> bool {
        self.announced
            || self.waiting.iter().any(|request| matches!(request.command, Ok(Command::DisconnectAnnouncement)))
    }

    /// Whether no request is running or waiting, and no frame waits to be sent.
    pub(super) fn is_idle(&self) -> bool {
        self.awaited == 0 && self.waiting.is_empty() && self.orders.is_empty() && self.frames.is_empty()
    }

    /// Discards the waiting requests of a client that is gone, except FAST STOPs.
    pub(super) fn forget_waiting(&mut self) {
        self.waiting.clear();
        self.subscriptions.clear();
    }

    /// Whether a silent client has automatic updates, or knows of a FAST STOP that it may want to acknowledge.
    pub(super) fn is_remembered(&self) -> bool {
        self.subscriptions.ids().next().is_some() || self.acknowledges.knows_any()
    }

    /// Whether a FAST STOP is unanswered.
    pub(super) fn is_stopping(&self) -> bool {
        self.fast_stops.under_way > 0
    }

    /// Whether the client does not read its replies, or sends garbage.
    pub(super) fn has_overflown(&self) -> bool {
        self.overflown || self.input.is_garbage()
    }

    fn take_requests(&mut self, now: Instant, state: &State) {
        while let Some(request) = self.input.next() {
            let id = request.id;
            match request.command {
                Ok(Command::FastStop) if self.fast_stops.waiting >= MAX_WAITING_REQUESTS => {
                    self.refuse(id, Status::E_OVERRUN, Cause::Overrun);
                }
                Ok(Command::FastStop) => {
                    self.fast_stops.waiting += 1;
                    self.begin_fast_stop();
                }
                Ok(Command::Stop) if self.stops >= MAX_STOPS => {
                    self.withdraw_motions();
                    self.refuse(id, Status::E_OVERRUN, Cause::Overrun);
                }
                Ok(Command::Stop) => {
                    self.withdraw_motions();
                    self.stops += 1;
                    self.motions_are_stopping = self.motions > 0;
                    self.order(id, false, PortOrder::Command(Action::Stop));
                }
                _ if self.waiting.len() >= MAX_WAITING_REQUESTS => {
                    self.refuse(id, Status::E_OVERRUN, Cause::Overrun);
                }
                command => {
                    let latched = state.latch.as_ref().map(|latch| latch.fast_stop_id);
                    let is_behind_fast_stop = self.is_stopping();
                    let request = WaitingRequest { id, command, latched, is_behind_fast_stop, overtaken: 0 };
                    self.enqueue(request);
                }
            }
            // Start what can be started before parsing the next request.
            self.take_up(now, state);
        }
    }

    /// Lets a request wait for its turn. The newest of a stream takes the place of the older one that still waits, since it
    /// has the client's present target. It answers that one, too.
    fn enqueue(&mut self, mut request: WaitingRequest) {
        let is_stream = self.custom_ids.stream.contains(&request.id) && request.command.is_ok();
        let place = self.waiting.iter().rposition(|older| older.id == request.id && older.command.is_ok());
        let Some(place) = place.filter(|_| is_stream) else { return self.waiting.push_back(request) };
        // A motion in between keeps its place in the order.
        let is_followed = self.waiting.range(place + 1..).any(|later| id::is_motion(later.id));
        if is_followed {
            return self.waiting.push_back(request);
        }
        let Some(older) = self.waiting.get_mut(place) else { return };
        request.overtaken = older.overtaken + 1;
        let id = request.id;
        let is_too_many = request.overtaken > MAX_WAITING_REQUESTS;
        request.overtaken = request.overtaken.min(MAX_WAITING_REQUESTS);
        *older = request;
        if is_too_many {
            self.status(id, Status::E_CMD_ABORTED);
        }
    }

    /// Combines all waiting FAST STOPs into one, unless one is running.
    fn begin_fast_stop(&mut self) {
        if self.fast_stops.under_way == 0 && self.fast_stops.waiting > 0 {
            self.fast_stops.under_way = std::mem::take(&mut self.fast_stops.waiting);
            self.order(id::FAST_STOP, true, PortOrder::FastStop);
        }
    }

    /// Withdraws the waiting motions: before a Stop, or because the client is lost.
    pub(super) fn withdraw_motions(&mut self) {
        self.withdraw_motions_if(|_| true);
    }

    fn withdraw_motions_if(&mut self, is_withdrawn: impl Fn(&WaitingRequest) -> bool) {
        let mut waiting = std::mem::take(&mut self.waiting);
        for request in waiting.iter_mut().filter(|request| self.moves(request.id) && is_withdrawn(request)) {
            request.command = Err(Unusable::Withdrawn);
        }
        self.waiting = waiting;
    }

    /// Whether a request of this id can change the device.
    fn is_change(&self, id: u8) -> bool {
        let stops = matches!(id, id::STOP | id::FAST_STOP | id::ACKNOWLEDGE_FAST_STOP);
        stops || id::acts(id) && !self.custom_ids.read.contains(&id)
    }

    /// Whether this id can move the fingers: a motion, or a script that is not listed as read-only.
    fn moves(&self, id: u8) -> bool {
        id::is_motion(id) || (id::describe(id).is_none() && !self.custom_ids.read.contains(&id))
    }

    /// Whether a motion has to wait for a Stop to finish. Sent earlier, it would be refused because of the motion that
    /// is being stopped.
    fn holds_a_motion_back(&self) -> bool {
        let is_stopping = self.stops > 0 || self.motions_are_stopping;
        is_stopping && self.waiting.front().is_some_and(|next| next.command.is_ok() && self.moves(next.id))
    }

    fn take_up(&mut self, now: Instant, state: &State) {
        // A motion requested before a FAST STOP must not run after its acknowledgement.
        if let Some(latch) = &state.latch {
            let all = self.holds_a_motion_back();
            let newest = Some(latch.fast_stop_id);
            self.withdraw_motions_if(|request| all || (request.latched != newest && !request.is_behind_fast_stop));
        }
        while self.awaited == 0
            && let Some(WaitingRequest { id, command, overtaken, .. }) = self.next_request()
        {
            match command {
                // fw4-en 3.1.2: refused until the connection has ended.
                _ if self.announced => {
                    for _ in 0..=overtaken {
                        self.refuse(id, Status::E_ACCESS_DENIED, Cause::Announced);
                    }
                }
                Ok(command) => self.execute(now, command, overtaken, state),
                Err(unusable) => {
                    for _ in 0..=overtaken {
                        self.refuse_unusable(id, unusable, state);
                    }
                }
            }
        }
    }

    fn next_request(&mut self) -> Option<WaitingRequest> {
        if self.holds_a_motion_back() { None } else { self.waiting.pop_front() }
    }

    fn execute(&mut self, now: Instant, command: Command, overtaken: usize, state: &State) {
        let id = command.id();
        match command {
            Command::GetSystemState(updates)
            | Command::GetGripperState(updates)
            | Command::GetWidth(updates)
            | Command::GetSpeed(updates)
            | Command::GetForce(updates) => self.query(now, id, updates, state),
            Command::AcknowledgeFastStop => self.acknowledge(state),
            Command::DisconnectAnnouncement => {
                self.announced = true;
                self.subscriptions.clear();
                self.order(id, true, PortOrder::Release);
            }
            command @ (Command::Custom(_) | Command::FingerPower { .. }) => {
                // Streamed requests wait for one another.
                let is_awaited = self.custom_ids.stream.contains(&id);
                self.order_for(PortRequest { id, is_awaited, overtaken }, PortOrder::Exchange(command));
            }
            command => {
                let order = Action::of(&command).map_or_else(|| PortOrder::Exchange(command), PortOrder::Command);
                self.order(id, true, order);
            }
        }
    }

    /// Refuses an unusable request. Motions are checked in the order of the manual's statuses: a FAST STOP or a running
    /// command is reported before a format error.
    fn refuse_unusable(&mut self, id: u8, unusable: Unusable, state: &State) {
        let status = match &state.latch {
            Some(latch) if id::is_motion(id) => {
                self.acknowledges.saw(latch.fast_stop_id);
                Status::E_ACCESS_DENIED
            }
            None if id::is_motion(id) && state.command.is_some() => Status::E_ALREADY_RUNNING,
            _ => unusable.status(),
        };
        match unusable {
            Unusable::Withdrawn => self.status(id, status),
            _ => self.refuse(id, status, Cause::Unusable(unusable)),
        }
    }

    /// Acknowledges a FAST STOP if this client may clear it.
    fn acknowledge(&mut self, state: &State) {
        let id = id::ACKNOWLEDGE_FAST_STOP;
        let is_held = state.lease_holder.is_some();
        match &state.latch {
            Some(latch) if self.acknowledges.allows(latch, is_held) => {
                self.order(id, true, PortOrder::Acknowledge(latch.fast_stop_id));
            }
            Some(_) => self.refuse(id, Status::E_ACCESS_DENIED, Cause::Acknowledge),
            None if state.link != Link::Connected => self.status(id, Status::E_IO_ERROR),
            None if state.fault_code >= MIN_DEVICE_FAULT => self.order(id, true, PortOrder::AcknowledgeFault),
            None => self.reply(id, &Reply::Success(Data::None)),
        }
    }

    fn order(&mut self, id: u8, is_awaited: bool, order: PortOrder) {
        self.order_for(PortRequest { id, is_awaited, overtaken: 0 }, order);
    }

    fn order_for(&mut self, ask: PortRequest, order: PortOrder) {
        self.awaited += usize::from(ask.is_awaited);
        self.motions += usize::from(id::is_motion(ask.id));
        self.orders.push_back(PortOrdered { ask, order });
    }

    fn refuse(&mut self, id: u8, status: Status, cause: Cause) {
        self.refused.push_back(Refused { id, status, cause });
        self.status(id, status);
    }

    /// Answers a request, and those of a stream that it has overtaken.
    fn status_of_all(&mut self, id: u8, status: Status, overtaken: usize) {
        for _ in 0..=overtaken {
            self.status(id, status);
        }
    }

    fn status(&mut self, id: u8, status: Status) {
        self.reply(id, &Reply::Status(status));
    }

    fn reply(&mut self, id: u8, reply: &Reply) {
        self.send(id, reply);
        if reply.status() != Status::E_CMD_PENDING {
            self.has_failed = reply.status() != Status::E_SUCCESS;
        }
    }

    fn send(&mut self, id: u8, reply: &Reply) {
        if self.frames.len() >= MAX_WAITING_FRAMES {
            self.overflown = true;
            return;
        }
        let mut frame = Vec::new();
        reply.encode(id, &mut frame);
        self.frames.push_back(frame);
    }
}

#[cfg(test)]
#[path = "device_tests.rs"]
mod tests;
