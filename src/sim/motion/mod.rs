//! The mechanics: the axis, its surroundings and the running motion, independent of frames. The outcome of a motion is
//! a [`StepOutcome`].

use wsg::{SoftLimits, Status};

use axis::{Axis, AxisDirection, Drive, Progress};
use grip::{Grip, Hold};
use world::World;

pub(crate) mod axis;
mod end_conditions;
pub(crate) mod grip;
pub(crate) mod world;

/// Number of pressing steps that count as a block.
const BLOCK_STEPS: u32 = 10;

/// Number of steps after which a blocked release or a jammed drive times out. The manuals name no time.
const TIMEOUT_STEPS: u32 = 3000;

/// Factor by which FAST STOP brakes harder than any motion.
const FAST_STOP_FACTOR: f64 = 4.0;

/// Distance in mm within which a width counts as at a limit.
pub(super) const AT_LIMIT_MM: f64 = 0.01;

/// A motion to start, in true widths.
#[derive(Debug, Clone)]
pub(super) enum Plan {
    Home { direction: AxisDirection, drive: Drive },
    Move { drive: Drive, clamp: bool },
    Grip(Grip),
    Release { drive: Drive },
}

/// Outcome of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum StepOutcome {
    /// The motion is over.
    Finished(Status),
    /// The fingers came to rest after a Stop.
    Stopped,
    /// The drive is jammed, and the Stop timed out.
    StopTimedOut,
    /// The held part is gone.
    PartLost,
    /// The block of a clamped motion is gone, and the fingers are at the target.
    SnappedToTarget,
    /// The fingers leave the soft limits.
    ForbiddenRange,
}

#[derive(Debug)]
enum Activity {
    Rest,
    Seek {
        direction: AxisDirection,
        drive: Drive,
        pressing: u32,
    },
    BackOff {
        drive: Drive,
        pressing: u32,
    },
    Move {
        drive: Drive,
        clamp: bool,
        pressing: u32,
    },
    Release {
        drive: Drive,
        pressing: u32,
    },
    /// A script's newest target. The fingers press on where they are blocked.
    Steer {
        drive: Drive,
        pressing: u32,
    },
    Grip(Grip),
    Hold(Hold),
    /// Clamp on block: keeps pressing, and snaps to the target when freed (`fw4-en 3.2.2`).
    Clamp {
        drive: Drive,
    },
    Stopping,
    /// A FAST STOP whose fingers are still moving.
    Braking,
}

#[derive(Debug)]
pub(super) struct Mechanics {
    pub axis: Axis,
    pub world: World,
    pub referenced: bool,
    pub blocked: Option<AxisDirection>,
    /// A Stop has reset the flag of the current block.
    block_stopped: bool,
    /// Number of steps of the motion or Stop while the drive is jammed: it does not move, and no block is detected.
    jammed: Option<u32>,
    activity: Activity,
    /// Difference between the device's width and the true width.
    offset_mm: f64,
    stroke_mm: f64,
    max_acceleration_mm_s2: f64,
    /// The fingers press with a constant force, so steps change nothing until a disturbance.
    steady: bool,
}

impl Mechanics {
    pub fn new(start_mm: f64, stroke_mm: f64, max_acceleration_mm_s2: f64) -> Self {
        Self {
            axis: Axis::new(start_mm),
            world: World::new(stroke_mm),
            referenced: false,
            blocked: None,
            block_stopped: false,
            jammed: None,
            activity: Activity::Rest,
            offset_mm: -start_mm,
            stroke_mm,
            max_acceleration_mm_s2,
            steady: false,
        }
    }

    /// Width that the device shows, relative to its origin.
    pub fn width_mm(&self) -> f64 {
        self.axis.position_mm + self.offset_mm
    }

    /// True width at which the device shows `width_mm`.
    pub fn true_mm(&self, width_mm: f64) -> f64 {
        width_mm - self.offset_mm
    }

    /// Whether a motion runs (`E_ALREADY_RUNNING`).
    pub fn is_running(&self) -> bool {
        match self.activity {
            Activity::Rest | Activity::Hold(_) => false,
            Activity::Clamp { .. } => self.axis.is_moving(),
            Activity::Steer { pressing, .. } => pressing == 0,
            _ => true,
        }
    }

    /// Flag `MOVING`.
    pub fn is_moving(&self) -> bool {
        match &self.activity {
            Activity::Seek { pressing, .. }
            | Activity::BackOff { pressing, .. }
            | Activity::Move { pressing, .. }
            | Activity::Release { pressing, .. }
            | Activity::Steer { pressing, .. } => *pressing == 0,
            Activity::Grip(grip) => !grip.is_pressing(),
            _ => self.axis.is_moving(),
        }
    }

    pub fn is_holding(&self) -> bool {
        self.holds_in().is_some()
    }

    /// Direction of the grip while a part is held.
    pub fn holds_in(&self) -> Option<AxisDirection> {
        if let Activity::Hold(hold) = &self.activity { Some(hold.direction()) } else { None }
    }

    /// Whether steps can change anything.
    pub fn needs_steps(&self) -> bool {
        self.world.is_changing()
            || match self.activity {
                Activity::Rest => false,
                Activity::Hold(_) | Activity::Clamp { .. } => !self.steady,
                _ => true,
            }
    }

    pub fn start(&mut self, plan: Plan) {
        self.blocked = None;
        self.block_stopped = false;
        self.set_jammed(self.jammed.is_some());
        self.steady = false;
        self.activity = match plan {
            Plan::Home { direction, drive } => {
                self.referenced = false;
                Activity::Seek { direction, drive, pressing: 0 }
            }
            Plan::Move { drive, clamp } => Activity::Move { drive, clamp, pressing: 0 },
            Plan::Grip(grip) => Activity::Grip(grip),
            Plan::Release { drive } => Activity::Release { drive, pressing: 0 },
        };
    }

    /// Moves the fingers towards a script's newest target. They keep their speed.
    pub fn steer(&mut self, drive: Drive) {
        self.block_stopped = false;
        self.set_jammed(self.jammed.is_some());
        self.steady = false;
        let pressing = if let Activity::Steer { pressing, .. } = self.activity { pressing } else { 0 };
        self.activity = Activity::Steer { drive, pressing };
    }

    /// Whether a script's target moves the fingers, or presses them on a part.
    pub fn is_steered(&self) -> bool {
        matches!(self.activity, Activity::Steer { .. })
    }

    /// Whether the fingers come to rest after a Stop or a FAST STOP.
    pub fn is_stopping(&self) -> bool {
        matches!(self.activity, Activity::Stopping | Activity::Braking)
    }

    /// Stops the fingers. [`StepOutcome::Stopped`] follows when the fingers are at rest; at once if nothing moves. A
    /// held part stays held unless `let_go`. Ruling: a Stop resets the flag of a block while holding too (`fw4-en`
    /// Appendix B).
    pub fn stop(&mut self, let_go: bool) -> Option<StepOutcome> {
        self.steady = false;
        match self.activity {
            Activity::Hold(_) if !let_go => {
                self.blocked = None;
                self.block_stopped = true;
            }
            Activity::Stopping | Activity::Braking => {}
            Activity::Rest => self.blocked = None,
            _ if self.axis.is_moving() || self.is_jammed() => {
                self.set_jammed(self.jammed.is_some());
                self.activity = Activity::Stopping;
            }
            _ => self.rest(),
        }
        if self.is_stopping() { None } else { Some(StepOutcome::Stopped) }
    }

    /// Stops the fingers the fastest way. A held part stays held unless `let_go`.
    pub fn fast_stop(&mut self, let_go: bool) {
        match self.activity {
            Activity::Hold(_) if !let_go => {}
            _ if self.axis.is_moving() => self.activity = Activity::Braking,
            _ => self.rest(),
        }
    }

    pub fn set_jammed(&mut self, jammed: bool) {
        self.jammed = jammed.then_some(0);
    }

    /// Whether a motion runs that the drive does not execute.
    fn is_jammed(&self) -> bool {
        self.jammed.is_some() && self.is_running()
    }

    /// Simulates a power loss: the fingers stop, and the origin is lost.
    pub fn restart(&mut self) {
        self.rest();
        self.referenced = false;
        self.offset_mm = -self.axis.position_mm;
    }

    /// Reacts to a change of the world or the force limit, after which the fingers may no longer be steady.
    pub fn disturb(&mut self) {
        self.steady = false;
        self.world.step(self.axis.position_mm);
        let surfaces = self.world.surfaces();
        if self.blocked.is_some_and(|direction| surfaces.depth_mm(direction, self.axis.position_mm) < -AT_LIMIT_MM) {
            self.blocked = None;
        }
        if matches!(self.activity, Activity::Rest) {
            self.axis.relax(&surfaces);
        }
    }

    /// Applies a new force limit to a held part, and in fw2 also to a block that is clamped (fw2 3.3.3).
    pub fn set_force_limit(&mut self, force_limit_n: f64, limits_clamping: bool) {
        match &mut self.activity {
            Activity::Hold(hold) => hold.set_force_limit(force_limit_n),
            Activity::Clamp { drive } if limits_clamping => drive.force_limit_n = force_limit_n,
            _ => return,
        }
        self.steady = false;
    }

    pub fn step(&mut self, soft_limits: Option<SoftLimits>) -> Option<StepOutcome> {
        self.world.step(self.axis.position_mm);
        let event = self.step_activity();
        if event.is_none() && self.enters_forbidden_range(soft_limits) {
            return Some(StepOutcome::ForbiddenRange);
        }
        event
    }

    fn step_jammed(&mut self) -> Option<StepOutcome> {
        self.axis.speed_mm_s = 0.0;
        let steps = self.jammed.map_or(0, |steps| steps + 1);
        self.jammed = Some(steps);
        let outcome = match self.activity {
            Activity::Braking => None,
            _ if steps < TIMEOUT_STEPS => return None,
            Activity::Stopping => Some(StepOutcome::StopTimedOut),
            _ => Some(StepOutcome::Finished(Status::E_TIMEOUT)),
        };
        self.rest();
        outcome
    }

    fn step_activity(&mut self) -> Option<StepOutcome> {
        if self.is_jammed() {
            return self.step_jammed();
        }
        let surfaces = self.world.surfaces();
        match &mut self.activity {
            Activity::Rest => None,
            Activity::Seek { direction, drive, pressing } => {
                let direction = *direction;
                count(pressing, self.axis.step(drive, &surfaces));
                if *pressing >= BLOCK_STEPS {
                    self.found_end_stop(direction);
                }
                None
            }
            Activity::BackOff { drive, pressing } => {
                let progress = self.axis.step(drive, &surfaces);
                count(pressing, progress);
                let blocked = *pressing >= BLOCK_STEPS;
                self.end_of_back_off(progress, blocked)
            }
            Activity::Move { drive, clamp, pressing } => {
                let drive = *drive;
                let clamp = *clamp;
                let progress = self.axis.step(&drive, &surfaces);
                count(pressing, progress);
                let blocked = *pressing >= BLOCK_STEPS;
                self.end_of_move(progress, blocked, clamp.then_some(drive))
            }
            Activity::Release { drive, pressing } => {
                let progress = self.axis.step(drive, &surfaces);
                count(pressing, progress);
                let steps = *pressing;
                self.end_of_release(progress, steps)
            }
            Activity::Steer { drive, pressing } => {
                let progress = self.axis.steer(drive, &surfaces);
                count(pressing, progress);
                let pressing = *pressing;
                self.end_of_steering_step(progress, pressing);
                None
            }
            Activity::Grip(grip) => {
                let grown = grip.step(&mut self.axis, &surfaces);
                self.end_of_grip(grown)
            }
            Activity::Hold(hold) => {
                let progress = hold.step(&mut self.axis, &surfaces);
                let direction = hold.direction();
                let is_lost = hold.is_lost(progress);
                self.steady = matches!(progress, Progress::Pressing(_));
                self.block_stopped &= self.steady;
                self.blocked = (self.steady && !self.block_stopped).then_some(direction);
                is_lost.then(|| {
                    self.rest();
                    StepOutcome::PartLost
                })
            }
            Activity::Clamp { drive } => {
                let progress = self.axis.step(drive, &surfaces);
                self.steady = matches!(progress, Progress::Pressing(_));
                self.blocked = if let Progress::Pressing(direction) = progress { Some(direction) } else { None };
                if progress == Progress::Reached {
                    self.activity = Activity::Rest;
                    return Some(StepOutcome::SnappedToTarget);
                }
                None
            }
            Activity::Stopping => {
                self.axis.brake(self.max_acceleration_mm_s2, &surfaces);
                (!self.axis.is_moving()).then(|| {
                    self.rest();
                    StepOutcome::Stopped
                })
            }
            Activity::Braking => {
                self.axis.brake(self.max_acceleration_mm_s2 * FAST_STOP_FACTOR, &surfaces);
                if !self.axis.is_moving() {
                    self.rest();
                }
                None
            }
        }
    }

    fn rest(&mut self) {
        self.axis.relax(&self.world.surfaces());
        self.blocked = None;
        self.steady = false;
        self.activity = Activity::Rest;
    }

    /// Whether the fingers move out of the soft limits (`fw4-en 3.3.5`). Homing ignores the limits, and moving back
    /// inside is allowed.
    fn enters_forbidden_range(&self, soft_limits: Option<SoftLimits>) -> bool {
        let homing = matches!(self.activity, Activity::Seek { .. } | Activity::BackOff { .. });
        let Some(limits) = soft_limits.filter(|_| self.referenced && !homing) else { return false };
        if self.is_stopping() {
            return false;
        }
        let minus_mm = f64::from(limits.minus().mm());
        let plus_mm = f64::from(limits.plus().mm());
        self.axis.speed_mm_s < 0.0 && self.width_mm() < minus_mm - AT_LIMIT_MM
            || self.axis.speed_mm_s > 0.0 && self.width_mm() > plus_mm + AT_LIMIT_MM
    }
}

fn count(pressing: &mut u32, progress: Progress) {
    *pressing = if matches!(progress, Progress::Pressing(_)) { *pressing + 1 } else { 0 };
}
