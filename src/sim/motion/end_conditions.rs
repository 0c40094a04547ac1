//! End conditions of each kind of motion, based on its newest step.

use wsg::Status;

use super::axis::{AxisDirection, Drive, Progress};
use super::grip::GripProgress;
use super::{Activity, BLOCK_STEPS, Mechanics, StepOutcome, TIMEOUT_STEPS};

/// Distance in mm by which the fingers back off after they found the end stop.
const BACK_OFF_MM: f64 = 1.0;

impl Mechanics {
    /// Makes the blocking position the origin, even if an obstacle blocked (`fw4-en 3.2.1`).
    pub(super) fn found_end_stop(&mut self, direction: AxisDirection) {
        let Activity::Seek { drive, .. } = self.activity else { return };
        self.axis.relax(&self.world.surfaces());
        self.offset_mm = match direction {
            AxisDirection::Closing => -self.axis.position_mm,
            AxisDirection::Opening => self.stroke_mm - self.axis.position_mm,
        };
        let target_mm = self.axis.position_mm - BACK_OFF_MM * direction.sign();
        self.activity = Activity::BackOff { drive: Drive { target_mm, ..drive }, pressing: 0 };
    }

    pub(super) fn end_of_back_off(&mut self, progress: Progress, blocked: bool) -> Option<StepOutcome> {
        match progress {
            Progress::Reached => {
                self.referenced = true;
                self.activity = Activity::Rest;
                Some(StepOutcome::Finished(Status::E_SUCCESS))
            }
            Progress::Pressing(direction) if blocked => Some(self.blocked_in(direction)),
            _ => None,
        }
    }

    pub(super) fn end_of_move(
        &mut self,
        progress: Progress,
        blocked: bool,
        clamp: Option<Drive>,
    ) -> Option<StepOutcome> {
        match progress {
            Progress::Reached => {
                self.activity = Activity::Rest;
                Some(StepOutcome::Finished(Status::E_SUCCESS))
            }
            // A hard limit was reached, and the gripper is stopped (`fw4-en 3.2.2`).
            Progress::Pressing(direction) if blocked && self.world.ends_in(direction) => {
                self.blocked_in(direction);
                Some(StepOutcome::Finished(Status::E_RANGE_ERROR))
            }
            Progress::Pressing(direction) if blocked => {
                let Some(drive) = clamp else { return Some(self.blocked_in(direction)) };
                self.blocked = Some(direction);
                self.steady = true;
                self.activity = Activity::Clamp { drive };
                Some(StepOutcome::Finished(Status::E_AXIS_BLOCKED))
            }
            _ => None,
        }
    }

    /// A blocked release times out, because `fw4-en 3.2.7` lists no `E_AXIS_BLOCKED`.
    pub(super) fn end_of_release(&mut self, progress: Progress, pressing: u32) -> Option<StepOutcome> {
        match progress {
            Progress::Reached => {
                self.activity = Activity::Rest;
                Some(StepOutcome::Finished(Status::E_SUCCESS))
            }
            Progress::Pressing(direction) => {
                self.blocked = (pressing >= BLOCK_STEPS).then_some(direction);
                (pressing >= TIMEOUT_STEPS).then(|| {
                    self.blocked_in(direction);
                    StepOutcome::Finished(Status::E_TIMEOUT)
                })
            }
            Progress::Moving => {
                self.blocked = None;
                None
            }
        }
    }

    /// The target of a script is reached, or the fingers press on: the script's next target follows.
    pub(super) fn end_of_steering_step(&mut self, progress: Progress, pressing: u32) {
        self.blocked = match progress {
            Progress::Pressing(direction) if pressing >= BLOCK_STEPS => Some(direction),
            _ => None,
        };
        if progress == Progress::Reached {
            self.activity = Activity::Rest;
        }
    }

    pub(super) fn end_of_grip(&mut self, grown: GripProgress) -> Option<StepOutcome> {
        match grown {
            GripProgress::NotYet { pressing } => {
                self.blocked = pressing;
                None
            }
            GripProgress::Held(hold) => {
                self.blocked = Some(hold.direction());
                self.steady = true;
                self.activity = Activity::Hold(hold);
                Some(StepOutcome::Finished(Status::E_SUCCESS))
            }
            GripProgress::Nothing { blocked } => {
                self.rest();
                self.blocked = blocked;
                Some(StepOutcome::Finished(Status::E_CMD_FAILED))
            }
        }
    }

    /// Ends the motion with the motor off and the block recorded.
    fn blocked_in(&mut self, direction: AxisDirection) -> StepOutcome {
        self.rest();
        self.blocked = Some(direction);
        StepOutcome::Finished(Status::E_AXIS_BLOCKED)
    }
}
