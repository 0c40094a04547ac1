//! The fingers that are mounted on a gripper, and their use.

use std::fmt;
use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::model::Client;
pub use crate::model::FingerSetId;

/// The fingers of a gripper, with their use since they were mounted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FingerSet {
    pub id: FingerSetId,
    pub mounted_at: Timestamp,
    /// Subject of the client that mounted the set.
    pub mounted_by: Arc<str>,
    /// Number of grips.
    pub cycles: u64,
    /// Distance that the fingers moved relative to each other, in mm.
    pub travel_mm: f64,
    /// Number of grips after which the set needs maintenance.
    pub maintenance_cycles: Option<u64>,
    /// Distance after which the set needs maintenance, in m.
    pub maintenance_travel_m: Option<f64>,
}

/// A request to mount a finger set.
#[derive(Debug, Clone, PartialEq)]
pub struct MountRequest {
    pub id: FingerSetId,
    pub maintenance_cycles: Option<u64>,
    pub maintenance_travel_m: Option<f64>,
    /// Whether to count from zero although the set is already mounted.
    pub reset: bool,
}

impl MountRequest {
    /// Returns the mounted set, which continues the counts of `before`.
    pub(super) fn into_finger_set(self, before: Option<FingerSet>, at: Timestamp, by: &Client) -> FingerSet {
        let Self { id, maintenance_cycles, maintenance_travel_m, .. } = self;
        let cycles = 0;
        let travel_mm = 0.0;
        let mounted_by = by.subject.clone();
        let new =
            FingerSet { id, mounted_at: at, mounted_by, cycles, travel_mm, maintenance_cycles, maintenance_travel_m };
        before.map_or(new, |before| FingerSet { maintenance_cycles, maintenance_travel_m, ..before })
    }
}

impl FingerSet {
    /// Counts a motion.
    pub(super) fn count_motion(&mut self, is_grip: bool, travel_mm: f64) {
        self.cycles += u64::from(is_grip);
        self.travel_mm += travel_mm;
    }

    /// Distance that the fingers moved relative to each other, in m.
    #[must_use]
    pub fn travel_m(&self) -> f64 {
        self.travel_mm / 1000.0
    }

    #[must_use]
    pub fn is_maintenance_due(&self) -> bool {
        self.maintenance_cycles.is_some_and(|due| self.cycles >= due)
            || self.maintenance_travel_m.is_some_and(|due| self.travel_m() >= due)
    }
}

impl fmt::Display for FingerSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "finger set {}, grips: {}, travel: {:.0} m", self.id.as_str(), self.cycles, self.travel_m())
    }
}
