//! Events from outside the protocol, as values: changes in the surroundings, device faults and link faults.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use wsg::frame;
use wsg::id;
use wsg::{Data, Reply, Status};

use super::link::faults::{FaultKind, FaultName};
use super::motion::world::Part;
use super::process::MotionKind;
use super::requests::getters::BrokenGetter;
use super::{Device, LinkAction};

/// An event that affects the device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Change {
    /// A part is put between the jaws. If it is too wide, it waits beside the jaws until they have opened.
    PlacePart(Part),
    /// The part is taken away.
    TakePart,
    /// The part shrinks or swells. The fingers follow within the clamping travel.
    ResizePart {
        /// New width of the part in mm.
        width_mm: f64,
    },
    /// The part slips out of the fingers, faster than they can follow.
    SlipPart,
    /// A hard obstacle is put in the way of the jaws.
    PlaceObstacle {
        /// Width in mm at which the jaws touch the obstacle, from either side.
        width_mm: f64,
    },
    /// The obstacle is removed.
    RemoveObstacle,
    /// The device keeps this temperature from now on. Its configuration has the thresholds.
    Overheat { temperature_c: f64 },
    /// The temperature follows the load again.
    Cool,
    /// The motor reaches its thermal limit, or recovers.
    CurrentFault {
        on: bool,
        /// Time after which the motor recovers by itself (`fw4-en` Appendix B).
        clears_after_ms: Option<u32>,
    },
    /// The power supply leaves its valid range, or returns to it.
    PowerFault { on: bool },
    /// Over-current in a finger's supply begins or ends.
    FingerOverCurrent {
        /// Finger 1 or 2.
        finger: u8,
        on: bool,
    },
    /// A finger's communication fails or recovers.
    FingerCommunicationFault {
        /// Finger 1 or 2.
        finger: u8,
        on: bool,
    },
    /// A motion from another source, such as the device's web page. Ignored while a motion runs or motion is blocked.
    MoveBySomebody { width_mm: f64, speed_mm_s: f64 },
    /// The drive jams or runs again. While it is jammed, motions and Stops end in `E_TIMEOUT`.
    Jam { on: bool },
    /// A FAST STOP that no client requested.
    SetFastStop,
    /// The script ends with an error. Its commands are unknown until it starts again.
    FailScript,
    /// The script is started.
    StartScript,
    /// The device restarts and loses its settings, origin, updates and connection.
    Reboot {
        /// Duration of the restart.
        ready_after_ms: u32,
        /// Whether the device still sends half a frame.
        #[serde(default)]
        mid_frame: bool,
    },
    /// The device executes requests but sends nothing.
    Silent { on: bool },
    /// The connection passes no bytes, and neither side notices its end, until a new connection begins.
    HalfOpen { on: bool },
    /// The device refuses new connections.
    RefuseConnections { on: bool },
    /// The connection is cut now (TCP).
    CutConnection,
    /// Arms a fault.
    Fault {
        kind: FaultKind,
        /// Id of the affected frames, or `None` for all.
        id: Option<u8>,
        /// Number of frames to affect.
        times: u32,
    },
    /// Disarms all pending faults.
    DisarmFaults,
    /// A getter no longer returns its value; the rest of the device goes on.
    BreakGetter {
        /// Id of the getter.
        id: u8,
        how: BrokenGetter,
    },
    /// All getters return their values again.
    MendGetters,
}

impl Device {
    /// Applies a change.
    #[allow(clippy::needless_pass_by_value, reason = "a change happens once")]
    pub fn apply(&mut self, now: Instant, change: Change) {
        self.advance(now);
        match change {
            Change::PlacePart(_)
            | Change::TakePart
            | Change::ResizePart { .. }
            | Change::SlipPart
            | Change::PlaceObstacle { .. }
            | Change::RemoveObstacle => self.change_world(&change),
            Change::Overheat { temperature_c } => self.thermal.hold(temperature_c),
            Change::Cool => self.thermal.let_go(),
            Change::CurrentFault { on, clears_after_ms } => self.set_current_fault(on, clears_after_ms),
            Change::PowerFault { on } => self.set_power_fault(on),
            Change::FingerOverCurrent { finger, on } => self.set_finger_over_current(finger_index(finger), on),
            Change::FingerCommunicationFault { finger, on } => {
                self.fingers[finger_index(finger)].communication_fault = on;
                self.count_if(on, FaultName::FingerFault);
            }
            Change::MoveBySomebody { width_mm, speed_mm_s } => self.foreign_motion(width_mm, speed_mm_s),
            Change::Jam { on } => self.mechanics.set_jammed(on),
            Change::SetFastStop => {
                self.faults.counts.add(FaultName::FastStop);
                self.fast_stop();
            }
            Change::FailScript => self.set_script(false),
            Change::StartScript => self.set_script(true),
            Change::Reboot { ready_after_ms, mid_frame } => self.reboot(ready_after_ms, mid_frame),
            Change::Silent { on } => (self.silent, self.muted) = (on, false),
            Change::HalfOpen { on } => self.half_open = on,
            Change::RefuseConnections { on } => self.refuses_connections = on,
            Change::CutConnection => self.cut_connection(),
            Change::Fault { kind, id, times } => self.faults.arm(kind, id, times),
            Change::DisarmFaults => self.faults.disarm(),
            Change::BreakGetter { id, how } => self.break_getter(id, how),
            Change::MendGetters => self.broken_getters.mend(),
        }
        self.settle();
    }

    fn change_world(&mut self, change: &Change) {
        let position_mm = self.mechanics.axis.position_mm;
        let world = &mut self.mechanics.world;
        let had_part = world.part().is_some();
        let fault = match *change {
            Change::PlacePart(part) => {
                world.place_part(part, position_mm);
                None
            }
            Change::TakePart => {
                world.take_part();
                had_part.then_some(FaultName::PartTaken)
            }
            Change::ResizePart { width_mm } => {
                world.resize_part(width_mm);
                None
            }
            Change::SlipPart => {
                world.slip_part();
                had_part.then_some(FaultName::PartSlipped)
            }
            Change::PlaceObstacle { width_mm } => {
                world.place_obstacle(width_mm, position_mm);
                Some(FaultName::Obstacle)
            }
            _ => {
                world.remove_obstacle();
                None
            }
        };
        self.mechanics.disturb();
        if let Some(name) = fault {
            self.faults.counts.add(name);
        }
    }

    fn set_current_fault(&mut self, on: bool, clears_after_ms: Option<u32>) {
        self.current_fault = on;
        let after = clears_after_ms.map(|ms| Duration::from_millis(ms.into()));
        self.current_fault_clears_at = after.filter(|_| on).map(|after| self.clock + after);
        self.count_if(on, FaultName::CurrentFault);
        if on {
            self.fast_stop();
        }
    }

    fn set_power_fault(&mut self, on: bool) {
        self.power_fault = on;
        self.count_if(on, FaultName::PowerFault);
        if on {
            self.fast_stop();
        }
    }

    /// An over-current switches the finger off, and ends a request that powers it up (`fw4-en 3.6.3`).
    fn set_finger_over_current(&mut self, index: usize, on: bool) {
        self.fingers[index].set_over_current(on);
        self.count_if(on, FaultName::FingerFault);
        if on && let Some(ticket) = self.finger_tickets[index].take() {
            self.result_status(ticket, Status::E_CMD_FAILED);
        }
    }

    fn set_script(&mut self, runs: bool) {
        let fails = self.script_runs && !runs;
        self.count_if(fails, FaultName::ScriptFailure);
        self.script_failed = fails;
        self.script_runs = runs && self.config.has_script();
        self.steering.clear();
    }

    fn foreign_motion(&mut self, width_mm: f64, speed_mm_s: f64) {
        let allowed = self.mechanics.referenced && !self.fast_stopped && !self.has_fault();
        if allowed && !self.is_running() && self.booting_until.is_none() {
            self.faults.counts.add(FaultName::ForeignMotion);
            let plan = self.plan_move(width_mm, speed_mm_s, false);
            self.start(None, MotionKind::Move, plan);
        }
    }

    fn reboot(&mut self, ready_after_ms: u32, mid_frame: bool) {
        self.faults.counts.add(FaultName::Reboot);
        let half = mid_frame.then(|| self.half_of_next_frame());
        if self.is_tcp() {
            self.link_actions.push_back(LinkAction::Drop);
            self.link = None;
        }
        self.forget_session();
        self.chunks.extend(half);
        self.running = None;
        self.stops.clear();
        self.finger_tickets = [None, None];
        self.mechanics.restart();
        self.process.restart();
        self.settings.restart(&self.config);
        self.fingers.iter_mut().for_each(super::fingers::FingerPort::restart);
        (self.fast_stopped, self.command_failed, self.muted) = (false, false, false);
        (self.script_runs, self.script_failed) = (self.config.has_script(), false);
        self.booting_until = Some(self.clock + Duration::from_millis(ready_after_ms.into()));
    }

    fn half_of_next_frame(&mut self) -> Vec<u8> {
        let mut bytes = self.outbox.pop().map_or_else(
            || {
                let mut bytes = Vec::new();
                Reply::Success(Data::SystemState(self.flags())).encode(id::GET_SYSTEM_STATE, &mut bytes);
                bytes
            },
            |frame| frame.bytes,
        );
        bytes.truncate((bytes.len() / 2).max(frame::PREAMBLE.len()));
        bytes
    }

    pub(super) fn cut_connection(&mut self) {
        if self.is_tcp() && !self.is_cut {
            self.is_cut = true;
            self.outbox.clear();
            self.link_actions.push_back(LinkAction::Drop);
        }
    }

    pub(super) fn count_if(&mut self, happened: bool, name: FaultName) {
        if happened {
            self.faults.counts.add(name);
        }
    }
}

fn finger_index(number: u8) -> usize {
    usize::from(number == 2)
}

#[cfg(test)]
#[path = "change_tests.rs"]
mod tests;
