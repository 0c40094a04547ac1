//! The measured values of the last ten minutes, so that a chart is full as soon as it is shown.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;
use utoipa::ToSchema;

use crate::gripper::model::{Link, Name, State};
use crate::gripper::{Grippers, Now};

/// Interval of the samples. A chart of ten minutes cannot show shorter changes.
const SAMPLED_EVERY: Duration = Duration::from_millis(200);

/// Samples of ten minutes: 120 kB for a gripper.
const MAX_SAMPLES: usize = 3000;

/// Values at one time; none while the gripper is not connected.
#[derive(Debug, Clone, Copy, PartialEq)]
struct TrendSample {
    at: Instant,
    width_mm: Option<f32>,
    speed_mm_s: Option<f32>,
    force_n: Option<f32>,
}

impl TrendSample {
    fn of(state: &State, at: Instant) -> Self {
        let is_there = state.link == Link::Connected;
        let value = |value: Option<f32>| value.filter(|_| is_there).map(|value| (value * 100.0).round() / 100.0);
        let (width_mm, speed_mm_s, force_n) = (state.width_mm, state.speed_mm_s, state.force_n);
        Self { at, width_mm: value(width_mm), speed_mm_s: value(speed_mm_s), force_n: value(force_n) }
    }

    fn values(&self) -> [Option<f32>; 3] {
        [self.width_mm, self.speed_mm_s, self.force_n]
    }
}

/// Measured values of a gripper, oldest first. All lists have the same length.
#[derive(Debug, PartialEq, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "age_ms": [400, 200, 0], "width_mm": [50.0, 48.5, 47.0], "speed_mm_s": [0.0, -7.5, -7.5],
    "force_n": [0.0, 0.0, null]
}))]
pub struct Trend {
    /// Name of the gripper.
    #[schema(value_type = String, max_length = 32)]
    gripper: Name,
    /// Age of each sample in ms. Samples within a stretch of equal values are left out.
    age_ms: Vec<u64>,
    /// Opening widths in mm; null where unknown.
    width_mm: Vec<Option<f32>>,
    /// Speeds of the fingers relative to each other, in mm/s; null where unknown.
    speed_mm_s: Vec<Option<f32>>,
    /// Gripping forces in N; null where unknown.
    force_n: Vec<Option<f32>>,
}

/// The measured values of all grippers.
#[derive(Debug, Default)]
pub struct Trends(Mutex<BTreeMap<Name, VecDeque<TrendSample>>>);

impl Trends {
    /// Samples all grippers until the gateway closes.
    pub async fn watch(self: Arc<Self>, grippers: Grippers, closing: CancellationToken) {
        let mut ticks = interval(SAMPLED_EVERY);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        while closing.run_until_cancelled(ticks.tick()).await.is_some() {
            let now = Now::read().instant;
            let grippers = grippers.all();
            self.all().retain(|name, _| grippers.iter().any(|gripper| gripper.name() == name));
            for gripper in grippers {
                self.take(gripper.name(), TrendSample::of(&gripper.state(), now));
            }
        }
    }

    fn take(&self, gripper: &Name, sample: TrendSample) {
        let mut all = self.all();
        let samples = all.entry(gripper.clone()).or_default();
        let len = samples.len();
        // Only the two ends of a stretch of equal values are kept.
        let before = len.checked_sub(2).and_then(|index| samples.get(index)).map(TrendSample::values);
        if let Some(last) =
            samples.back_mut().filter(|last| [before, Some(sample.values())] == [Some(last.values()); 2])
        {
            last.at = sample.at;
        } else {
            if len == MAX_SAMPLES {
                samples.pop_front();
            }
            samples.push_back(sample);
        }
        let is_old = |sample: &TrendSample, now: Instant| {
            now.saturating_duration_since(sample.at) > SAMPLED_EVERY * MAX_SAMPLES as u32
        };
        // The first sample can be older, because it begins a stretch.
        while samples.get(1).is_some_and(|second| is_old(second, sample.at)) {
            samples.pop_front();
        }
    }

    /// Returns the values of the last ten minutes.
    #[must_use]
    pub fn of(&self, gripper: &Name) -> Trend {
        let now = Now::read().instant;
        let samples: Vec<_> = self.all().get(gripper).into_iter().flatten().copied().collect();
        Trend {
            gripper: gripper.clone(),
            age_ms: samples.iter().map(|one| now.saturating_duration_since(one.at).as_millis() as u64).collect(),
            width_mm: samples.iter().map(|one| one.width_mm).collect(),
            speed_mm_s: samples.iter().map(|one| one.speed_mm_s).collect(),
            force_n: samples.iter().map(|one| one.force_n).collect(),
        }
    }

    fn all(&self) -> MutexGuard<'_, BTreeMap<Name, VecDeque<TrendSample>>> {
        // After a panic under the lock, at most one sample is missing.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name() -> Name {
        "left".parse().unwrap()
    }

    /// Samples of these widths, one each interval.
    fn sampled(widths: impl IntoIterator<Item = f32>) -> Trends {
        let (trends, begin) = (Trends::default(), Instant::now());
        for (index, width) in widths.into_iter().enumerate() {
            let at = begin + SAMPLED_EVERY * u32::try_from(index).unwrap();
            trends.take(&name(), TrendSample { at, width_mm: Some(width), speed_mm_s: None, force_n: None });
        }
        trends
    }

    #[test]
    fn stretch_of_equal_values_keeps_its_ends() {
        let trend = sampled([1.0, 2.0, 2.0, 2.0, 2.0, 3.0]).of(&name());
        assert_eq!(trend.width_mm, [Some(1.0), Some(2.0), Some(2.0), Some(3.0)]);
        assert_eq!(trend.force_n, [None; 4]);
    }

    #[test]
    fn samples_are_bounded_in_number_and_age() {
        let widths = (0..10_000_u16).map(f32::from);
        assert_eq!(sampled(widths).of(&name()).width_mm.len(), MAX_SAMPLES);
        let standing = [1.0, 2.0, 3.0].into_iter().chain(std::iter::repeat_n(4.0, 2 * MAX_SAMPLES));
        assert_eq!(sampled(standing).of(&name()).width_mm, [Some(4.0), Some(4.0)]);
        assert!(Trends::default().of(&name()).age_ms.is_empty());
    }

    #[test]
    fn lost_link_is_a_gap() {
        let there = State { link: Link::Connected, width_mm: Some(5.0), ..State::unknown(name()) };
        let gone = State { link: Link::Reconnecting, ..there.clone() };
        let width = |state| TrendSample::of(state, Instant::now()).width_mm;
        assert_eq!((width(&there), width(&gone)), (Some(5.0), None));
    }
}
