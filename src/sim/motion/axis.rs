//! The axis: trapezoidal motion in fixed steps, and contact of the fingers with surfaces.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::world::Surfaces;

/// Time step of the simulation.
pub const STEP: Duration = Duration::from_millis(1);

/// [`STEP`] in seconds.
const STEP_S: f64 = 0.001;

/// Speed limit in mm/s while the fingers press on a surface.
const CONTACT_SPEED_MM_S: f64 = 10.0;

/// Direction of a finger motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxisDirection {
    /// Negative, to the inner end stop.
    Closing,
    /// Positive, to the outer end stop.
    Opening,
}

impl AxisDirection {
    pub(crate) const fn sign(self) -> f64 {
        match self {
            Self::Closing => -1.0,
            Self::Opening => 1.0,
        }
    }

    pub(crate) const fn opposite(self) -> Self {
        match self {
            Self::Closing => Self::Opening,
            Self::Opening => Self::Closing,
        }
    }

    /// Direction from one width to another. Equal widths count as closing.
    pub(crate) fn towards(from_mm: f64, to_mm: f64) -> Self {
        if to_mm > from_mm { Self::Opening } else { Self::Closing }
    }
}

/// Target and limits of a motion.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drive {
    pub target_mm: f64,
    pub speed_mm_s: f64,
    pub acceleration_mm_s2: f64,
    pub force_limit_n: f64,
}

/// Outcome of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Progress {
    Moving,
    /// The fingers are at the target.
    Reached,
    /// The fingers press on a surface with the force limit.
    Pressing(AxisDirection),
}

#[derive(Debug)]
pub(crate) struct Axis {
    /// True distance between the jaws.
    pub position_mm: f64,
    /// Positive while opening.
    pub speed_mm_s: f64,
    pub force_n: f64,
}

impl Axis {
    pub fn new(position_mm: f64) -> Self {
        Self { position_mm, speed_mm_s: 0.0, force_n: 0.0 }
    }

    pub fn is_moving(&self) -> bool {
        self.speed_mm_s.abs() > 0.0
    }

    /// Moves by one step towards the drive's target.
    pub fn step(&mut self, drive: &Drive, surfaces: &Surfaces) -> Progress {
        let direction = AxisDirection::towards(self.position_mm, drive.target_mm);
        let remaining_mm = (drive.target_mm - self.position_mm).abs();
        let depth_mm = surfaces.depth_mm(direction, self.position_mm);
        let deepest_mm = drive.force_limit_n / surfaces.against(direction).stiffness_n_mm;

        let braking_mm_s = (2.0 * drive.acceleration_mm_s2 * remaining_mm).sqrt();
        let faster_mm_s = self.speed_mm_s.abs() + drive.acceleration_mm_s2 * STEP_S;
        let mut speed_mm_s = faster_mm_s.min(drive.speed_mm_s).min(braking_mm_s);
        let mut travel_mm = speed_mm_s * STEP_S;
        if depth_mm + travel_mm > 0.0 {
            speed_mm_s = speed_mm_s.min(CONTACT_SPEED_MM_S);
            let gap_mm = (-depth_mm).max(0.0);
            travel_mm = gap_mm + (travel_mm - gap_mm).min(CONTACT_SPEED_MM_S * STEP_S);
        }

        let room_mm = deepest_mm - depth_mm;
        let progress = if remaining_mm <= travel_mm && remaining_mm <= room_mm {
            self.position_mm = drive.target_mm;
            Progress::Reached
        } else if travel_mm >= room_mm {
            self.position_mm += room_mm * direction.sign();
            Progress::Pressing(direction)
        } else {
            self.position_mm += travel_mm * direction.sign();
            Progress::Moving
        };
        self.speed_mm_s = if progress == Progress::Moving { speed_mm_s * direction.sign() } else { 0.0 };
        self.force_n = surfaces.force_n(self.position_mm).min(drive.force_limit_n);
        progress
    }

    /// Moves by one step towards a target that may have changed during the motion: the fingers brake before they turn
    /// around, and to a lower speed. With a speed of 0, they brake until they stand still.
    pub fn steer(&mut self, drive: &Drive, surfaces: &Surfaces) -> Progress {
        let direction = AxisDirection::towards(self.position_mm, drive.target_mm);
        let is_turning = self.speed_mm_s * direction.sign() < 0.0;
        let stops = drive.speed_mm_s <= 0.0;
        if is_turning || stops {
            self.brake(drive.acceleration_mm_s2, surfaces);
            return if stops && !self.is_moving() { Progress::Reached } else { Progress::Moving };
        }
        let slowest_mm_s = self.speed_mm_s.abs() - drive.acceleration_mm_s2 * STEP_S;
        self.step(&Drive { speed_mm_s: drive.speed_mm_s.max(slowest_mm_s), ..*drive }, surfaces)
    }

    /// Brakes for one step.
    pub fn brake(&mut self, deceleration_mm_s2: f64, surfaces: &Surfaces) {
        let direction = if self.speed_mm_s > 0.0 { AxisDirection::Opening } else { AxisDirection::Closing };
        let speed_mm_s = (self.speed_mm_s.abs() - deceleration_mm_s2 * STEP_S).max(0.0);
        self.speed_mm_s = speed_mm_s * direction.sign();
        self.position_mm += self.speed_mm_s * STEP_S;
        if !self.is_moving() || surfaces.depth_mm(direction, self.position_mm) >= 0.0 {
            self.relax(surfaces);
        }
    }

    /// Switches the motor off: pressed surfaces spring back, and the force drops to 0.
    pub fn relax(&mut self, surfaces: &Surfaces) {
        for direction in [AxisDirection::Closing, AxisDirection::Opening] {
            if surfaces.depth_mm(direction, self.position_mm) > 0.0 {
                self.position_mm = surfaces.against(direction).at_mm;
            }
        }
        self.speed_mm_s = 0.0;
        self.force_n = 0.0;
    }
}

#[cfg(test)]
#[path = "axis_tests.rs"]
mod tests;
