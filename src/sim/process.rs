//! The gripper state (`fw4-en 3.4.2`), the statistics, and the flags set by motions.

use std::time::{Duration, Instant};

use wsg::{GripperState, Statistics, Status};

use super::motion::axis::AxisDirection;

/// Delay in fw4 from the end of MOVING to TARGET_POS_REACHED (`fw4-en` Appendix B).
const TARGET_REACHED_DELAY: Duration = Duration::from_millis(5);

/// Kind of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MotionKind {
    Home,
    Move,
    Grip(AxisDirection),
    Release,
}

#[derive(Debug)]
pub(super) struct Process {
    pub state: GripperState,
    pub statistics: Statistics,
    pub axis_stopped: bool,
    pub target_reached: bool,
    /// Time at which TARGET_POS_REACHED follows.
    pub target_reached_at: Option<Instant>,
    /// Direction of the last grip, until another motion.
    gripped: Option<AxisDirection>,
    is_fw4: bool,
}

impl Process {
    pub fn new(is_fw4: bool) -> Self {
        Self {
            state: GripperState::Idle,
            statistics: Statistics::default(),
            axis_stopped: false,
            target_reached: false,
            target_reached_at: None,
            gripped: None,
            is_fw4,
        }
    }

    /// Resets everything except the statistics.
    pub fn restart(&mut self) {
        *self = Self { statistics: self.statistics, ..Self::new(self.is_fw4) };
    }

    /// Whether a grip in `direction` needs a release first, after a grip in the opposite direction (`fw4-en 3.2.6`, not
    /// in fw2). Ruling: "a subsequent grip command" is the next motion. Homing and pre-positioning end the gripping
    /// process, too (`fw4-en 3.4.2`), so that the ban ends.
    pub fn forbids_grip(&self, direction: AxisDirection) -> bool {
        self.is_fw4 && self.gripped == Some(direction.opposite())
    }

    pub fn started(&mut self, kind: MotionKind) {
        self.axis_stopped = false;
        self.target_reached = false;
        self.target_reached_at = None;
        match kind {
            MotionKind::Grip(direction) => {
                self.gripped = Some(direction);
                // Ruling: a grip counts once it is executed, whatever its result (42h).
                self.statistics.total = self.statistics.total.saturating_add(1);
            }
            MotionKind::Release | MotionKind::Home | MotionKind::Move => self.gripped = None,
        }
        self.state = match kind {
            MotionKind::Grip(_) => GripperState::Grasping,
            MotionKind::Release => GripperState::Releasing,
            // fw2: NO_PART and PART_LOST last until the next grip or release, and homing has no own state.
            MotionKind::Home | MotionKind::Move if !self.is_fw4 && self.has_result() => self.state,
            MotionKind::Home if !self.is_fw4 => GripperState::Idle,
            MotionKind::Home | MotionKind::Move => GripperState::Positioning,
        };
    }

    pub fn finished(&mut self, kind: MotionKind, status: Status, now: Instant) {
        let success = status == Status::E_SUCCESS;
        self.state = match kind {
            MotionKind::Grip(_) if success => GripperState::Holding,
            MotionKind::Grip(_) if status == Status::E_CMD_FAILED => {
                self.statistics.no_part = self.statistics.no_part.saturating_add(1);
                GripperState::NoPart
            }
            MotionKind::Home | MotionKind::Move if !self.is_fw4 && self.has_result() => self.state,
            // Ruling: fw4's ERROR follows every motion that fails (`fw4-en 3.4.2`).
            _ if !success => self.error(),
            _ => GripperState::Idle,
        };
        // fw2 names only "a Goto or Grasp command" (Appendix B).
        let has_target = match kind {
            MotionKind::Home => false,
            MotionKind::Release => self.is_fw4,
            MotionKind::Move | MotionKind::Grip(_) => true,
        };
        if success && has_target {
            self.reached_target(now);
        }
    }

    /// Ends the gripping process, because a script moves the fingers.
    pub fn steered(&mut self) {
        self.axis_stopped = false;
        self.target_reached = false;
        self.target_reached_at = None;
        self.gripped = None;
        self.state = GripperState::Idle;
    }

    /// Sets TARGET_POS_REACHED, in fw4 after a delay. The gripper state stays: it tells how the motion ended.
    pub fn reached_target(&mut self, now: Instant) {
        self.target_reached = !self.is_fw4;
        self.target_reached_at = self.is_fw4.then(|| now + TARGET_REACHED_DELAY);
    }

    pub fn part_lost(&mut self) {
        self.statistics.lost_part = self.statistics.lost_part.saturating_add(1);
        // A part can also be lost after a FAST STOP. The state does not change then.
        if self.state == GripperState::Holding {
            self.state = GripperState::PartLost;
        }
    }

    /// Ends the process after Stop, or after a disconnect announcement.
    pub fn aborted(&mut self) {
        if !self.has_result() {
            self.state = GripperState::Idle;
        }
    }

    pub fn fast_stopped(&mut self) {
        self.target_reached_at = None;
        if self.is_fw4 || !self.has_result() {
            self.state = self.error();
        }
    }

    pub fn after_delay(&mut self) {
        self.target_reached_at = None;
        self.target_reached = true;
    }

    fn has_result(&self) -> bool {
        matches!(self.state, GripperState::NoPart | GripperState::PartLost)
    }

    /// State after an error. fw2 reserves 7.
    fn error(&self) -> GripperState {
        if self.is_fw4 { GripperState::Error } else { GripperState::Idle }
    }
}
