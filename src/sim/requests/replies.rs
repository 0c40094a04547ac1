//! Replies: `E_CMD_PENDING` and results of two-step requests, and the faults that affect them.

use std::time::{Duration, Instant};

use wsg::{Data, Reply, Status, id};

use crate::Device;
use crate::link::faults::{FaultKind, FaultName, FaultStage};
use crate::link::outbox::Outgoing;

/// Limit of delayed results; further ones are sent at once.
const MAX_LATE_RESULTS: usize = 64;

/// A request that waits for its reply.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PendingReply {
    pub id: u8,
    connection: u64,
    /// `E_CMD_PENDING` was sent or suppressed, so the result is the second step.
    two_step: bool,
    owes_pending: bool,
}

/// A result delayed by a fault.
#[derive(Debug)]
pub(crate) struct Late {
    pub at: Instant,
    ticket: PendingReply,
    reply: Reply,
}

impl Device {
    pub(crate) fn ticket(&self, id: u8) -> PendingReply {
        PendingReply { id, connection: self.connection, two_step: false, owes_pending: false }
    }

    /// Sends `E_CMD_PENDING`, and returns the ticket for the result.
    pub(crate) fn pending(&mut self, id: u8) -> PendingReply {
        let mut ticket = PendingReply { two_step: true, ..self.ticket(id) };
        match self.faults.take(id, FaultStage::Pending) {
            None => self.send(id, &Reply::Status(Status::E_CMD_PENDING), false),
            Some(FaultKind::FinalBeforePending) => ticket.owes_pending = true,
            Some(_) => {}
        }
        if self.faults.take_if(id, FaultStage::Result, |kind| kind == FaultKind::SilenceAfterAccept).is_some() {
            self.muted = true;
        }
        ticket
    }

    /// Answers a one-step request.
    pub(crate) fn answer(&mut self, id: u8, reply: Reply) {
        let ticket = self.ticket(id);
        self.result(ticket, reply);
    }

    pub(crate) fn answer_status(&mut self, id: u8, status: Status) {
        let ticket = self.ticket(id);
        self.result_status(ticket, status);
    }

    pub(crate) fn result_status(&mut self, ticket: PendingReply, status: Status) {
        let success = status == Status::E_SUCCESS;
        self.result(ticket, if success { Reply::Success(Data::None) } else { Reply::Status(status) });
    }

    pub(crate) fn result(&mut self, ticket: PendingReply, reply: Reply) {
        let mut failed = reply.status() != Status::E_SUCCESS;
        let fault = self
            .faults
            .take_if(ticket.id, FaultStage::Result, |kind| ticket.two_step || kind != FaultKind::PendingWithoutFinal);
        match fault {
            Some(FaultKind::PendingWithoutFinal) => {}
            Some(FaultKind::SilenceAfterAccept) => self.muted = true,
            Some(FaultKind::FinalStatus { code }) => {
                let reply = with_status(reply, Status::from_code(code));
                failed = reply.status() != Status::E_SUCCESS;
                self.deliver(ticket, &reply);
            }
            Some(FaultKind::FinalLate { by_ms }) if self.late.len() < MAX_LATE_RESULTS => {
                let at = self.clock + Duration::from_millis(by_ms.into());
                self.late.push(Late { at, ticket, reply });
            }
            Some(FaultKind::FinalTwice) => {
                self.deliver(ticket, &reply);
                self.deliver(PendingReply { owes_pending: false, ..ticket }, &reply);
            }
            _ => self.deliver(ticket, &reply),
        }
        self.command_failed = failed;
    }

    pub(crate) fn send_late(&mut self) {
        while let Some(index) = self.late.iter().position(|late| late.at <= self.clock) {
            let late = self.late.remove(index);
            self.deliver(late.ticket, &late.reply);
        }
    }

    fn deliver(&mut self, ticket: PendingReply, reply: &Reply) {
        if ticket.connection != self.connection {
            return;
        }
        self.send(ticket.id, reply, false);
        if ticket.owes_pending {
            self.send(ticket.id, &Reply::Status(Status::E_CMD_PENDING), false);
        }
    }

    pub(crate) fn send(&mut self, id: u8, reply: &Reply, is_update: bool) {
        if self.link.is_none() || self.is_cut || self.booting_until.is_some() {
            return;
        }
        if self.half_open {
            self.faults.counts.add(FaultName::HalfOpen);
            return;
        }
        if self.silent || self.muted {
            self.faults.counts.add(FaultName::Silent);
            return;
        }
        if let Some(bytes) = self.frame_of(id, reply) {
            self.outbox.push(Outgoing { id, is_update, at: self.clock, bytes });
        }
    }

    /// Applies an armed fault to a request. Returns `true` if the request must not be executed.
    pub(super) fn strikes_request(&mut self, id: u8) -> bool {
        match self.faults.take(id, FaultStage::Request) {
            Some(FaultKind::Status { code }) => {
                let status = Status::from_code(code);
                self.command_failed = status != Status::E_SUCCESS;
                self.send(id, &with_status(Reply::Success(Data::None), status), false);
                true
            }
            Some(_) => true,
            None => false,
        }
    }

    /// Answers Loop, after `E_CMD_PENDING` if so configured (`fw4-en 3.1.1`).
    pub(super) fn answer_loop(&mut self, data: Vec<u8>) {
        if self.config.loop_is_pending {
            self.send(id::LOOP, &Reply::Status(Status::E_CMD_PENDING), false);
        }
        self.answer(id::LOOP, Reply::Success(Data::Loop(data)));
    }
}

/// Replaces the status of a reply. A reply that already has this status keeps its data.
fn with_status(reply: Reply, status: Status) -> Reply {
    if status == reply.status() { reply } else { Reply::Status(status) }
}
