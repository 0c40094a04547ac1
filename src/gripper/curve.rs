//! Measurements during a motion: the samples, and the contact that follows from them.

use std::time::{Duration, Instant};

use model::Sample;

/// Most samples of one motion, enough for the longest travel at the fastest updates. Further samples are dropped.
const MAX_SAMPLES: usize = 32_768;

/// Time that a grip's curve continues after the grip's end, while the force settles.
pub(super) const TAIL: Duration = Duration::from_secs(1);

/// Fraction of the peak force that counts as contact with the part; smaller forces come from friction.
const CONTACT_SHARE: f32 = 0.1;

/// Curve of a motion under way.
#[derive(Debug, Default)]
pub(super) struct MotionCurve {
    since: Option<Instant>,
    samples: Vec<Sample>,
}

/// First contact of the fingers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contact {
    pub width_mm: f32,
    pub after_ms: u64,
}

impl MotionCurve {
    /// Adds a sample.
    pub(super) fn take(&mut self, now: Instant, width_mm: f32, speed_mm_s: f32, force_n: f32) {
        if self.samples.len() >= MAX_SAMPLES {
            return;
        }
        let since = *self.since.get_or_insert(now);
        // u32 milliseconds last 49 days, longer than any motion.
        let t_ms = now.saturating_duration_since(since).as_millis() as u32;
        self.samples.push(Sample { t_ms, width_mm, speed_mm_s, force_n });
    }

    /// Force of the greatest magnitude.
    pub(super) fn peak_force_n(&self) -> Option<f32> {
        self.samples.iter().map(|sample| sample.force_n).max_by(|a, b| a.abs().total_cmp(&b.abs()))
    }

    /// First of the samples with at least [`CONTACT_SHARE`] of the peak force that lead to the peak without a gap: an
    /// earlier, separate force came from friction.
    pub(super) fn contact(&self) -> Option<Contact> {
        let magnitudes = self.samples.iter().map(|sample| sample.force_n.abs());
        let peak = magnitudes.max_by(f32::total_cmp).filter(|peak| *peak > 0.0)?;
        let at_peak = self.samples.iter().position(|sample| sample.force_n.abs() >= peak)?;
        let leading = self.samples[..=at_peak].iter().rev();
        let first = leading.take_while(|sample| sample.force_n.abs() >= peak * CONTACT_SHARE).last()?;
        Some(Contact { width_mm: first.width_mm, after_ms: first.t_ms.into() })
    }

    /// Distance that the fingers moved relative to each other, back and forth, in mm with two
    /// decimals.
    pub(super) fn travel_mm(&self) -> f32 {
        let ways = self.samples.windows(2).map(|pair| f64::from(pair[1].width_mm - pair[0].width_mm).abs());
        ((ways.sum::<f64>() * 100.0).round() / 100.0) as f32
    }

    pub(super) fn into_samples(self) -> Vec<Sample> {
        self.samples
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contact_is_where_the_force_begins_to_rise() {
        let (mut curve, start) = (MotionCurve::default(), Instant::now());
        for (index, (width, force)) in [(30.0, 0.0), (25.0, 0.5), (20.0, 8.0), (19.9, 40.0)].into_iter().enumerate() {
            curve.take(start + Duration::from_millis(10 * index as u64), width, 50.0, force);
        }
        assert_eq!(curve.contact(), Some(Contact { width_mm: 20.0, after_ms: 20 }));
        assert_eq!(curve.peak_force_n(), Some(40.0));
        assert_eq!(curve.travel_mm().to_string(), "10.1");
        assert_eq!(curve.into_samples().len(), 4);
    }

    #[test]
    fn friction_before_the_contact_is_no_contact() {
        let (mut curve, start) = (MotionCurve::default(), Instant::now());
        for (index, (width, force)) in [(30.0, 6.0), (25.0, 0.5), (20.0, 8.0), (19.9, 40.0)].into_iter().enumerate() {
            curve.take(start + Duration::from_millis(10 * index as u64), width, 50.0, force);
        }
        assert_eq!(curve.contact(), Some(Contact { width_mm: 20.0, after_ms: 20 }));
    }

    #[test]
    fn no_force_is_no_contact() {
        let mut curve = MotionCurve::default();
        assert_eq!(curve.contact(), None);
        curve.take(Instant::now(), 30.0, 50.0, 0.0);
        assert_eq!((curve.contact(), curve.peak_force_n()), (None, Some(0.0)));
    }
}
