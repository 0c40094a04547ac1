//! State of each id: free; in use by one request, or by several Stops or FAST STOPs; or closed after a timeout until no
//! late reply can arrive.

use std::time::Instant;

use super::{LATE_REPLIES_WITHIN, Token, barrier::LoopGeneration};
use crate::{Data, Reply, Status, id};

/// Limit of Stops, and of FAST STOPs, in flight. It bounds the memory if the device answers none.
const MAX_STOPS_IN_FLIGHT: usize = 8;

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
    /// Time limit for the result, counted from acceptance.
    pub result_within: std::time::Duration,
    pub accepted: bool,
    pub two_step: bool,
    /// A Stop or FAST STOP was confirmed meanwhile, so the result may never arrive.
    pub stopped: bool,
    /// Number of frames written before: orders frames written at the same instant.
    pub order: u64,
    /// Data that the reply to a Loop must echo.
    pub echo: Option<Vec<u8>>,
}

/// An id whose last request can still get a late or duplicate reply.
#[derive(Debug)]
pub(super) struct Closed {
    /// Time at which the id was closed.
    pub at: Instant,
    /// The id opens after the echo of a Loop newer than this.
    pub since: LoopGeneration,
    pub echoed: bool,
    pub two_step: bool,
    /// Time until which a script can still reply, whatever has been echoed.
    pub script_until: Option<Instant>,
    /// Time until which a reply that the echo has overtaken can arrive.
    pub duplicate_until: Option<Instant>,
}

impl Closed {
    /// Closes an id until the echo of a Loop newer than `since`.
    pub(super) fn until_echo(at: Instant, since: LoopGeneration) -> Self {
        Self { at, since, echoed: false, two_step: false, script_until: None, duplicate_until: None }
    }

    /// Whether the id opens with an echo, or without one after [`LATE_REPLIES_WITHIN`].
    fn awaits_echo(&self) -> bool {
        !self.echoed && self.script_until.is_none()
    }

    /// Whether the reply to the last request can arrive after the echo.
    pub(super) fn awaits_result(&self) -> bool {
        self.two_step || self.script_until.is_some()
    }
}

/// Meaning of a status for a request in flight.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Accepted,
    Final,
    /// The status belongs to an earlier request of the id.
    Late,
}

impl InFlight {
    /// Whether `reply` is a late or duplicate echo of another Loop.
    pub(super) fn is_foreign_echo(&self, reply: &Reply) -> bool {
        match (&self.echo, reply) {
            (Some(sent), Reply::Success(Data::Loop(echoed))) => sent != echoed,
            _ => false,
        }
    }

    pub(super) fn judge(&self, id: u8, status: Status) -> Verdict {
        let premature = if crate::id::is_motion(id) {
            status.only_ends_a_motion()
        } else {
            // Finger power: over-current is reported at once, success only after E_CMD_PENDING (`fw4-en 3.6.3`).
            status == Status::E_SUCCESS
        };
        match (status, self.accepted) {
            (Status::E_CMD_PENDING, false) => Verdict::Accepted,
            (Status::E_CMD_PENDING, true) => Verdict::Late,
            (_, false) if self.two_step && premature => Verdict::Late,
            (status, true) if status.only_refuses() => Verdict::Late,
            _ => Verdict::Final,
        }
    }
}

/// All ids that are not open. Few at a time, so a list is faster than a map; never more than 270.
#[derive(Debug, Default)]
pub(super) struct Slots(Vec<Slot>);

impl Slots {
    pub(super) fn is_open(&self, id: u8) -> bool {
        !self.0.iter().any(|slot| slot.id == id)
    }

    /// Whether one more stop may be written: all stops in flight were written before the frame with the order `start`,
    /// so they do not stop its effect.
    pub(super) fn admit_another(&self, id: u8, start: Option<u64>) -> bool {
        let mut stops = self.in_flight().filter(|(in_flight_id, _)| *in_flight_id == id);
        stops.clone().count() < MAX_STOPS_IN_FLIGHT && stops.all(|(_, stop)| Some(stop.order) < start)
    }

    /// Whether a finger is powering up by the only request of this id.
    pub(super) fn is_powering_up(&self, id: u8) -> bool {
        let mut of_id = self.0.iter().filter(|slot| slot.id == id);
        let Some(Slot { state: SlotState::InFlight(in_flight), .. }) = of_id.next() else { return false };
        in_flight.two_step && in_flight.accepted && of_id.next().is_none()
    }

    /// Whether several requests of this id wait for their replies.
    pub(super) fn has_several(&self, id: u8) -> bool {
        self.0.iter().filter(|slot| slot.id == id).count() > 1
    }

    /// Ids whose replies can arrive.
    pub(super) fn ids(&self) -> impl Iterator<Item = u8> {
        self.0.iter().map(|slot| slot.id)
    }

    /// Whether the end of a motion is not known.
    pub(super) fn has_motion(&self) -> bool {
        self.0.iter().any(|slot| id::is_motion(slot.id))
    }

    pub(super) fn get_mut(&mut self, id: u8) -> Option<&mut Slot> {
        self.0.iter_mut().find(|slot| slot.id == id)
    }

    pub(super) fn insert(&mut self, id: u8, in_flight: InFlight) {
        self.0.push(Slot { id, state: SlotState::InFlight(in_flight) });
    }

    /// Ends the oldest request of this id. Only Stops, FAST STOPs and finger power can have more than one.
    pub(super) fn open(&mut self, id: u8) {
        if let Some(index) = self.0.iter().position(|slot| slot.id == id) {
            self.0.remove(index);
        }
    }

    pub(super) fn retain(&mut self, keep: impl FnMut(&mut Slot) -> bool) {
        self.0.retain_mut(keep);
    }

    fn closed(&self) -> impl Iterator<Item = (u8, &Closed)> {
        self.0.iter().filter_map(|slot| match &slot.state {
            SlotState::Closed(closed) => Some((slot.id, closed)),
            SlotState::InFlight(_) => None,
        })
    }

    pub(super) fn closed_mut(&mut self) -> impl Iterator<Item = &mut Closed> {
        self.0.iter_mut().filter_map(|slot| match &mut slot.state {
            SlotState::Closed(closed) => Some(closed),
            SlotState::InFlight(_) => None,
        })
    }

    /// Whether a request that acts on the gripper was written, and nothing shows that the device has received it.
    pub(super) fn may_act_late(&self) -> bool {
        self.0.iter().any(|slot| match &slot.state {
            SlotState::InFlight(in_flight) => id::acts(slot.id) && !in_flight.accepted,
            SlotState::Closed(closed) => id::acts(slot.id) && !closed.echoed,
        })
    }

    /// The next time at which a closed id opens without an echo.
    pub(super) fn echo_deadline(&self) -> Option<Instant> {
        let waiting = self.closed().filter(|(_, closed)| closed.awaits_echo());
        waiting.map(|(_, closed)| closed.at + LATE_REPLIES_WITHIN).min()
    }

    /// Lets the ids that have waited for long enough go on as after an echo.
    pub(super) fn stop_waiting_for_echoes(&mut self, now: Instant) {
        self.retain(|slot| match &mut slot.state {
            SlotState::Closed(closed) if closed.awaits_echo() && closed.at + LATE_REPLIES_WITHIN <= now => {
                closed.echoed = true;
                closed.two_step
            }
            _ => true,
        });
    }

    /// Whether the script with this id can still reply to an earlier request.
    pub(super) fn awaits_script(&self, id: u8) -> bool {
        self.closed().any(|(closed_id, closed)| closed_id == id && closed.script_until.is_some())
    }

    /// The next time at which a script's id no longer waits for its reply.
    pub(super) fn script_deadline(&self) -> Option<Instant> {
        self.closed().filter_map(|(_, closed)| closed.script_until).min()
    }

    /// The next time at which an id opens whose echo can have overtaken a reply.
    pub(super) fn duplicate_deadline(&self) -> Option<Instant> {
        let overtaken = self.closed().filter(|(_, closed)| closed.echoed && !closed.two_step);
        overtaken.filter_map(|(_, closed)| closed.duplicate_until).min()
    }

    /// Opens the ids that have waited long enough for a reply that the echo has overtaken.
    pub(super) fn expire_duplicates(&mut self, now: Instant) {
        self.retain(|slot| match &slot.state {
            SlotState::Closed(closed) => {
                !(closed.echoed && !closed.two_step && closed.duplicate_until.is_some_and(|until| until <= now))
            }
            SlotState::InFlight(_) => true,
        });
    }

    pub(super) fn in_flight_mut(&mut self) -> impl Iterator<Item = (u8, &mut InFlight)> {
        self.0.iter_mut().filter_map(|slot| match &mut slot.state {
            SlotState::InFlight(in_flight) => Some((slot.id, in_flight)),
            SlotState::Closed(_) => None,
        })
    }

    pub(super) fn in_flight(&self) -> impl Iterator<Item = (u8, &InFlight)> + Clone {
        self.0.iter().filter_map(|slot| match &slot.state {
            SlotState::InFlight(in_flight) => Some((slot.id, in_flight)),
            SlotState::Closed(_) => None,
        })
    }
}
