//! A client that reads after its own changes, as drivers of the WSG port do. Each answer must be a value that the device
//! had at or after the change.

use std::time::Instant;

use gripper::handle::ActorRequest;
use gripper::{Rejection, Ticket};
use model::{Client, Door, FastStopId, Outcome};
use rand::RngExt;
use sim::{FaultName, Interface};
use tokio::sync::oneshot;
use wsg::{Command, Data, GripperState, SystemState, Updates, id};

use super::world::World;

/// Getters that are asked after each change.
const GETTERS: [u8; 5] = [id::GET_SYSTEM_STATE, id::GET_GRIPPER_STATE, id::GET_WIDTH, id::GET_SPEED, id::GET_FORCE];

/// Greatest difference that rounding can cause, in mm, mm/s and N.
const ROUNDING: f64 = 0.001;

/// A change that a client waits for.
pub enum Followed {
    Command(Ticket),
    FastStop(FastStopId),
}

/// A change under way.
struct OwnChange {
    followed: Followed,
    /// Id of its frame.
    id: u8,
    requested_at: Instant,
}

/// A query that follows a change.
struct OwnRead {
    id: u8,
    /// Time at which the device received the change.
    since: Instant,
    answered: oneshot::Receiver<Result<Data, Rejection>>,
}

/// Values that the device has, whatever it sends.
#[derive(Debug, Clone, Copy, PartialEq)]
struct DeviceValues {
    flags: SystemState,
    state: GripperState,
    width_mm: f64,
    speed_mm_s: f64,
    force_n: f64,
}

/// The client's changes and reads.
#[derive(Default)]
pub struct OwnChanges {
    changes: Vec<OwnChange>,
    reads: Vec<OwnRead>,
    /// Values of the device since the oldest change under way.
    history: Vec<(Instant, DeviceValues)>,
}

impl OwnChanges {
    /// Follows a request of the client, now and then.
    pub fn follow(world: &mut World, id: u8, followed: Followed) {
        // A device that is stopped already shows the FAST STOP before it gets the request.
        let is_shown = id == id::FAST_STOP && world.device.snapshot().fast_stop;
        if world.rng.random_bool(0.5) && !is_disturbed(world) && !is_shown {
            world.own_changes.changes.push(OwnChange { followed, id, requested_at: world.now });
            Self::watch(world);
        }
    }

    /// Notes the values of the device after it may have changed.
    pub fn watch(world: &mut World) {
        let own = &mut world.own_changes;
        if own.all_answered() && own.changes.is_empty() {
            own.history.clear();
            return;
        }
        let snapshot = world.device.snapshot();
        let values = DeviceValues {
            // This flag is about the last request of the gateway.
            flags: snapshot.flags - SystemState::CMD_FAILURE,
            state: snapshot.gripper_state,
            width_mm: snapshot.width_mm,
            speed_mm_s: snapshot.speed_mm_s,
            force_n: snapshot.force_n,
        };
        if own.history.last().is_none_or(|(_, newest)| *newest != values) {
            own.history.push((world.now, values));
        }
    }

    /// Whether every query has its answer.
    pub fn all_answered(&self) -> bool {
        self.reads.is_empty()
    }

    /// Asks for the values after each change that was answered, and checks the answers.
    pub fn check(world: &mut World) {
        let changes = std::mem::take(&mut world.own_changes.changes);
        for change in changes {
            match change.has_happened(world) {
                None => world.own_changes.changes.push(change),
                Some(false) => {}
                Some(true) => Self::ask(world, &change),
            }
        }
        let reads = std::mem::take(&mut world.own_changes.reads);
        for mut read in reads {
            match read.answered.try_recv() {
                Err(oneshot::error::TryRecvError::Empty) => world.own_changes.reads.push(read),
                Err(oneshot::error::TryRecvError::Closed) => panic!("a query has no answer\n{}", world.tail()),
                Ok(answer) => {
                    world.count("query: after a change", answer.is_ok());
                    if let Ok(data) = answer
                        && !is_disturbed(world)
                    {
                        let is_right = world.own_changes.had(&data, read.since);
                        assert!(is_right, "own_change_is_seen: {:02X}h {data:?}\n{}", read.id, world.tail());
                    }
                }
            }
        }
    }

    fn ask(world: &mut World, change: &OwnChange) {
        let received = world.device.received().iter().rev();
        let executed =
            received.take_while(|frame| frame.at >= change.requested_at).filter(|frame| frame.id == change.id).last();
        // Another client's request may have had the same effect.
        let Some(since) = executed.map(|frame| frame.at) else { return };
        for id in GETTERS {
            let command = Command::query(id, Updates::Off).unwrap();
            let client = Client::new("wsg:10.0.0.3", Door::Wsg);
            let (answer, answered) = oneshot::channel();
            let now = world.clock();
            world.actor.request(now, ActorRequest::Exchange { command, client, lease: None, answer: (None, answer) });
            world.own_changes.reads.push(OwnRead { id, since, answered });
        }
    }

    /// Whether the device has had this value since `since`.
    fn had(&self, data: &Data, since: Instant) -> bool {
        let begin = self.history.partition_point(|(at, _)| *at < since);
        // A value holds until the next one.
        let first = if self.history.get(begin).is_some_and(|(at, _)| *at == since) { begin } else { begin - 1 };
        let values = || self.history[first..].iter().map(|(_, values)| values);
        let within = |value: f32, of: fn(&DeviceValues) -> f64| {
            let least = values().map(of).fold(f64::MAX, f64::min);
            let greatest = values().map(of).fold(f64::MIN, f64::max);
            (least - ROUNDING..=greatest + ROUNDING).contains(&value.into())
        };
        match data {
            Data::SystemState(flags) => values().any(|had| had.flags == *flags - SystemState::CMD_FAILURE),
            Data::GripperState(state) => values().any(|had| had.state == *state),
            Data::Width(width) => within(width.mm(), |had| had.width_mm),
            Data::Speed(speed) => within(speed.mm_s(), |had| had.speed_mm_s),
            Data::Force(force) => within(force.n(), |had| had.force_n),
            _ => true,
        }
    }
}

impl OwnChange {
    /// Whether the client knows that the change has happened; `None` while it waits.
    fn has_happened(&self, world: &World) -> Option<bool> {
        match &self.followed {
            Followed::Command(ticket) => {
                let command = ticket.now();
                match command.outcome {
                    None if self.id != id::STOP && command.accepted => Some(true),
                    None => None,
                    Some(outcome) => Some(outcome == Outcome::Success),
                }
            }
            Followed::FastStop(fast_stop) => {
                let state = world.watches.state.borrow();
                match &state.latch {
                    Some(latch) if latch.fast_stop_id == *fast_stop => latch.fast_stop_confirmed.then_some(true),
                    _ => Some(false),
                }
            }
        }
    }
}

/// Whether a reply can have come from an earlier request, or a value from before. Replies have no numbers.
fn is_disturbed(world: &World) -> bool {
    let spoils = |name: FaultName| {
        matches!(
            name,
            FaultName::Status
                | FaultName::FinalStatus
                | FaultName::FinalTwice
                | FaultName::FinalLate
                | FaultName::FinalWithoutPending
                | FaultName::FinalBeforePending
                | FaultName::BrokenGetter
        )
    };
    let stalled = ["wire: device stalled", "wire: requests stalled"];
    world.interface == Interface::Udp
        || stalled.iter().any(|name| world.counts.get(*name).is_some_and(|count| *count > 0))
        || world.device.fault_counts().iter().any(|(name, count)| spoils(name) && count > 0)
}
