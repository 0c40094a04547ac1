//! Gripping and holding a part (`fw4-en 3.2.6`): the fingers move beyond the nominal width until they reach the force
//! limit or the end of the clamping travel.

use super::axis::{Axis, AxisDirection, Drive, Progress};
use super::world::Surfaces;

/// Number of steps with the full force before a part counts as held.
const SETTLE_STEPS: u32 = 30;

/// Number of steps without contact after which a held part is lost.
const LOST_STEPS: u32 = 20;

/// Share of the force limit that counts as contact.
const CONTACT_SHARE: f64 = 0.05;

/// A grip in progress.
#[derive(Debug, Clone)]
pub(crate) struct Grip {
    drive: Drive,
    direction: AxisDirection,
    /// Bounds of the widths at which a part is recognised.
    from_mm: f64,
    to_mm: f64,
    pressing: u32,
}

/// Outcome of a grip's step.
#[derive(Debug)]
pub(crate) enum GripProgress {
    NotYet { pressing: Option<AxisDirection> },
    Held(Hold),
    Nothing { blocked: Option<AxisDirection> },
}

impl Grip {
    /// Grips a part of `nominal_mm`. Contact counts from `tolerance_mm` before that width to the target of `drive`, the
    /// end of the clamping travel.
    pub fn new(drive: Drive, direction: AxisDirection, nominal_mm: f64, tolerance_mm: f64) -> Self {
        let first_mm = nominal_mm - direction.sign() * tolerance_mm;
        let from_mm = first_mm.min(drive.target_mm);
        let to_mm = first_mm.max(drive.target_mm);
        Self { drive, direction, from_mm, to_mm, pressing: 0 }
    }

    pub fn is_pressing(&self) -> bool {
        self.pressing > 0
    }

    pub fn step(&mut self, axis: &mut Axis, surfaces: &Surfaces) -> GripProgress {
        let direction = match axis.step(&self.drive, surfaces) {
            Progress::Pressing(direction) => direction,
            Progress::Moving => {
                self.pressing = 0;
                return GripProgress::NotYet { pressing: None };
            }
            // End of the clamping travel. A soft part may be present without resisting with the requested force.
            Progress::Reached => return GripProgress::Nothing { blocked: None },
        };
        self.pressing += 1;
        if self.pressing < SETTLE_STEPS {
            return GripProgress::NotYet { pressing: Some(direction) };
        }
        if (self.from_mm..=self.to_mm).contains(&axis.position_mm) {
            GripProgress::Held(Hold { drive: self.drive, direction: self.direction, without_contact: 0 })
        } else {
            GripProgress::Nothing { blocked: Some(direction) }
        }
    }
}

/// A part held with the gripping force.
#[derive(Debug)]
pub(crate) struct Hold {
    drive: Drive,
    direction: AxisDirection,
    without_contact: u32,
}

impl Hold {
    pub fn direction(&self) -> AxisDirection {
        self.direction
    }

    pub fn set_force_limit(&mut self, force_limit_n: f64) {
        self.drive.force_limit_n = force_limit_n;
    }

    /// Moves the fingers by one step. They follow the part within the clamping travel.
    pub fn step(&mut self, axis: &mut Axis, surfaces: &Surfaces) -> Progress {
        let progress = axis.step(&self.drive, surfaces);
        let contact = axis.force_n >= self.drive.force_limit_n * CONTACT_SHARE;
        self.without_contact = if contact { 0 } else { self.without_contact + 1 };
        progress
    }

    pub fn is_lost(&self, progress: Progress) -> bool {
        progress == Progress::Reached || self.without_contact >= LOST_STEPS
    }
}

#[cfg(test)]
#[path = "grip_tests.rs"]
mod tests;
