//! Drift of contact widths: a control chart of their moving average (Roberts 1959).

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::journal::{Distribution, NEWEST_WEIGHS};
use crate::model::{Kind, PartId};
use crate::settings::{decimal, settings};

/// Number of grips that a chart learns from before it can warn.
const LEARNED_FROM: u64 = 30;

settings! {
    /// Distances of the moving average from the learned mean that count as drift. The larger one applies.
    #[derive(Copy)]
    pub struct DriftLimits {
        /// Drift limit, as a number of standard deviations of the moving average.
        pub sigmas: f64 = "sigmas", decimal(6.0, 1.0..=100.0), Reload;
        /// Smallest drift limit, in mm. It applies if the limit from `sigmas` is smaller.
        pub min_mm: f64 = "min_mm", decimal(0.05, 0.001..=100.0), Reload;
    }
}

/// Chart of the widths at which a gripper meets a part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct DriftChart {
    pub(super) kind: Kind,
    pub(super) part_id: PartId,
    /// Newest version of the recipe with which the part was gripped.
    pub(super) recipe_version: Option<u64>,
    /// Widths of the first grips, in mm.
    learned: Distribution,
    /// Moving average of the widths, in mm. Begins with the mean of the first grips.
    average_mm: f64,
    is_outside: bool,
}

impl DriftChart {
    pub(super) fn new(kind: Kind, part_id: PartId) -> Self {
        let learned = Distribution::default();
        Self { kind, part_id, recipe_version: None, learned, average_mm: 0.0, is_outside: false }
    }

    /// Takes the width of the next grip. A drift ends within half of the limit, so that it does not end and begin again
    /// with each grip.
    pub(super) fn take(&mut self, width_mm: f64, limits: Option<DriftLimits>) {
        if self.is_learning() {
            self.learned.take(width_mm);
            self.average_mm = self.learned.mean().unwrap_or(width_mm);
            return;
        }
        self.average_mm += NEWEST_WEIGHS * (width_mm - self.average_mm);
        self.judge(limits);
    }

    /// Compares the average with the limits.
    pub(super) fn judge(&mut self, limits: Option<DriftLimits>) {
        let limit_mm = limits.map(|limits| self.limit_mm(limits));
        let limit_mm = if self.is_outside { limit_mm.map(|limit_mm| limit_mm / 2.0) } else { limit_mm };
        self.is_outside = limit_mm.is_some_and(|limit_mm| self.distance_mm().abs() > limit_mm);
    }

    fn limit_mm(&self, limits: DriftLimits) -> f64 {
        let deviation_mm = self.learned.standard_deviation().unwrap_or_default();
        // Standard deviation of the average of many values.
        let of_average_mm = deviation_mm * (NEWEST_WEIGHS / (2.0 - NEWEST_WEIGHS)).sqrt();
        (limits.sigmas * of_average_mm).max(limits.min_mm)
    }

    /// Distance of the average from the mean of the first grips.
    fn distance_mm(&self) -> f64 {
        self.average_mm - self.learned.mean().unwrap_or(self.average_mm)
    }

    pub(super) fn is_learning(&self) -> bool {
        self.learned.count < LEARNED_FROM
    }

    pub(super) fn is_drifting(&self) -> bool {
        self.is_outside
    }
}

impl fmt::Display for DriftChart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = if self.kind == Kind::Reference { "gauge" } else { "part" };
        let part_id = self.part_id.as_str();
        let average_mm = self.average_mm;
        let distance_mm = self.distance_mm();
        write!(
            f,
            "{what} {part_id}: contact width {average_mm:.3} mm on average, {distance_mm:+.3} mm from the first \
             {LEARNED_FROM} grips"
        )
    }
}
