//! What each id is doing: one request in flight, or closed after a time-out until nothing late can come any more.

use std::time::Instant;

use super::{Token, barrier::Generation};
use crate::wsg::{Data, Reply, Status};

/// An id that is not open.
#[derive(Debug)]
pub(super) struct Slot {
    pub id: u8,
    pub state: SlotState,
}

#[derive(Debug)]
pub(super) enum SlotState {
    InFlight(InFlight),
    Closed(Closed),
}

/// A written request.
#[derive(Debug)]
pub(super) struct InFlight {
    pub token: Token,
    pub sent_at: Instant,
    pub deadline: Instant,
    /// How long the result may take once the request has been accepted.
    pub result_within: std::time::Duration,
    pub accepted: bool,
    pub two_step: bool,
    /// A Stop or FAST STOP was confirmed meanwhile, so the result may never come.
    pub stopped: bool,
    /// Counts what was written, since two frames can be written at one instant.
    pub order: u64,
    /// What a Loop's reply has to bring back.
    pub echo: Option<Vec<u8>>,
}

/// A request that timed out, and whose reply may still come.
#[derive(Debug)]
pub(super) struct Closed {
    /// Opens after the echo of a Loop that is newer than this.
    pub since: Generation,
    pub echoed: bool,
    pub two_step: bool,
}

/// What a status means to a request in flight.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Accepted,
    Final,
    /// It belongs to an earlier request of the id.
    Late,
}

impl InFlight {
    /// Whether it is the echo of another Loop: one that came twice, or late.
    pub(super) fn is_foreign_echo(&self, reply: &Reply) -> bool {
        match (&self.echo, reply) {
            (Some(sent), Reply::Success(Data::Loop(echoed))) => sent != echoed,
            _ => false,
        }
    }

    pub(super) fn judge(&self, id: u8, status: Status) -> Verdict {
        let premature = if crate::wsg::id::is_motion(id) {
            status.only_ends_a_motion()
        } else {
            // A finger's power: over-current is told at once, success only after E_CMD_PENDING (`fw4-en 3.6.3`).
            status == Status::E_SUCCESS
        };
        match (status, self.accepted) {
            (Status::E_CMD_PENDING, false) => Verdict::Accepted,
            (Status::E_CMD_PENDING, true) => Verdict::Late,
            (_, false) if self.two_step && premature => Verdict::Late,
            _ => Verdict::Final,
        }
    }
}

/// The ids that are not open. Few at a time, so a list is quicker than a map, and never grows beyond 256.
#[derive(Debug, Default)]
pub(super) struct Slots(Vec<Slot>);

impl Slots {
    pub(super) fn is_open(&self, id: u8) -> bool {
        !self.0.iter().any(|slot| slot.id == id)
    }

    pub(super) fn get_mut(&mut self, id: u8) -> Option<&mut Slot> {
        self.0.iter_mut().find(|slot| slot.id == id)
    }

    pub(super) fn insert(&mut self, id: u8, in_flight: InFlight) {
        self.0.push(Slot { id, state: SlotState::InFlight(in_flight) });
    }

    pub(super) fn open(&mut self, id: u8) {
        self.0.retain(|slot| slot.id != id);
    }

    pub(super) fn retain(&mut self, keep: impl FnMut(&mut Slot) -> bool) {
        self.0.retain_mut(keep);
    }

    pub(super) fn in_flight_mut(&mut self) -> impl Iterator<Item = (u8, &mut InFlight)> {
        self.0.iter_mut().filter_map(|slot| match &mut slot.state {
            SlotState::InFlight(in_flight) => Some((slot.id, in_flight)),
            SlotState::Closed(_) => None,
        })
    }

    pub(super) fn in_flight(&self) -> impl Iterator<Item = (u8, &InFlight)> {
        self.0.iter().filter_map(|slot| match &slot.state {
            SlotState::InFlight(in_flight) => Some((slot.id, in_flight)),
            SlotState::Closed(_) => None,
        })
    }
}
