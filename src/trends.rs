//! The measured values of the last ten minutes, so that a chart is full as soon as it is shown.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use jiff::Timestamp;
use serde::Serialize;
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;
use utoipa::ToSchema;

use crate::gripper::{Grippers, Now};
use crate::model::{Name, State};

/// Interval of the samples. A chart of ten minutes cannot show shorter changes.
const SAMPLED_EVERY: Duration = Duration::from_millis(200);

/// Samples of ten minutes: 120 kB for a gripper.
const MAX_SAMPLES: usize = 3000;

/// Values at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
struct TrendSample {
    at: Instant,
    /// The same time by the wall clock; `None` if no value is known.
    measured_at: Option<Timestamp>,
    width_mm: Option<f32>,
    speed_mm_s: Option<f32>,
    force_n: Option<f32>,
}

impl TrendSample {
    /// The values that are known now. Their time is that of the newest frame, or now if no value is known.
    fn of(state: &State, now: Instant) -> Self {
        let values = &state.values;
        Self {
            at: values.newest(now).unwrap_or(now),
            measured_at: values.measured_at(now),
            width_mm: values.width_mm(now).map(rounded),
            speed_mm_s: values.speed_mm_s(now).map(rounded),
            force_n: values.force_n(now).map(rounded),
        }
    }

    fn values(&self) -> [Option<f32>; 3] {
        [self.width_mm, self.speed_mm_s, self.force_n]
    }
}

/// A value with two decimals.
fn rounded(value: f32) -> f32 {
    (value * 100.0).round() / 100.0
}

/// Measured values of a gripper, oldest first. All lists have the same length.
#[derive(Debug, PartialEq, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "age_ms": [405, 205, 5], "measured_at": "2026-11-29T10:30:00.123456Z", "width_mm": [50.0, 48.5, 47.0], "speed_mm_s": [0.0, -7.5, -7.5],
    "force_n": [0.0, 0.0, null]
}))]
pub struct Trend {
    /// Name of the gripper.
    gripper: Name,
    /// Age of each sample in ms: the time since the newest of its frames arrived. Samples within a stretch of equal
    /// values are left out.
    age_ms: Vec<u64>,
    /// Time at which the frame of the newest sample arrived, in UTC with microseconds. The other samples arrived as much
    /// earlier as their ages are greater. Null before the first connection.
    #[serde(serialize_with = "crate::model::time::microseconds_or_null")]
    #[schema(required)]
    measured_at: Option<Timestamp>,
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
            last.measured_at = sample.measured_at;
        } else {
            if len == MAX_SAMPLES {
                samples.pop_front();
            }
            samples.push_back(sample);
        }
        let kept_for = SAMPLED_EVERY * MAX_SAMPLES as u32;
        // The first sample can be older, because it begins a stretch.
        while samples.get(1).is_some_and(|second| sample.at.saturating_duration_since(second.at) > kept_for) {
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
            measured_at: samples.last().and_then(|sample| sample.measured_at),
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
    use crate::model::{Link, Values};
    use crate::wsg::{GripperState, SystemState};

    fn name() -> Name {
        "left".parse().unwrap()
    }

    /// Samples of these widths, one each interval.
    fn sampled(widths: impl IntoIterator<Item = f32>) -> Trends {
        let (trends, begin) = (Trends::default(), Instant::now());
        for (index, width) in widths.into_iter().enumerate() {
            let at = begin + SAMPLED_EVERY * u32::try_from(index).unwrap();
            trends.take(
                &name(),
                TrendSample { at, measured_at: None, width_mm: Some(width), speed_mm_s: None, force_n: None },
            );
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
        let values = Values::fixed(SystemState::REFERENCED, GripperState::Idle, [5.0, 0.0, 0.0]);
        let mut state = State { link: Link::Connected, values, ..State::unknown(name()) };
        assert_eq!(TrendSample::of(&state, Instant::now()).width_mm, Some(5.0));
        state.values.forget();
        assert_eq!(TrendSample::of(&state, Instant::now()).width_mm, None);
    }

    #[test]
    fn sample_has_the_time_of_its_frame() {
        let values = Values::fixed(SystemState::REFERENCED, GripperState::Idle, [5.0, 0.0, 0.0]);
        let arrived_at = values.flags.arrived_at().unwrap();
        let state = State { link: Link::Connected, values, ..State::unknown(name()) };
        let sample = TrendSample::of(&state, arrived_at + Duration::from_secs(3));
        assert_eq!((sample.at, sample.measured_at), (arrived_at, Some(Timestamp::UNIX_EPOCH)));
    }
}
