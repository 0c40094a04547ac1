//! Encoding of curves: each sample is the difference to the one before, in steps finer than the device's resolution.

use crate::model::Sample;

/// Steps of a width: 0.001 mm.
const STEPS_PER_MM: f64 = 1000.0;

/// Steps of a speed: 0.01 mm/s.
const STEPS_PER_MM_S: f64 = 100.0;

/// Steps of a force: 0.01 N.
const STEPS_PER_N: f64 = 100.0;

/// Time, width, speed and force in steps.
type Steps = [i64; 4];

/// Error of bytes that do not encode a curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the curve cannot be decoded")]
pub(super) struct NoCurve;

pub(super) fn encode(samples: &[Sample]) -> Vec<u8> {
    let mut before = Steps::default();
    let differences: Vec<Steps> = samples
        .iter()
        .map(|sample| {
            let steps = to_steps(sample);
            let difference = std::array::from_fn(|i| steps[i].wrapping_sub(before[i]));
            before = steps;
            difference
        })
        .collect();
    postcard::to_stdvec(&differences).unwrap_or_default()
}

pub(super) fn decode(bytes: &[u8]) -> Result<Vec<Sample>, NoCurve> {
    let (differences, rest): (Vec<Steps>, _) = postcard::take_from_bytes(bytes).map_err(|_| NoCurve)?;
    if !rest.is_empty() {
        return Err(NoCurve);
    }
    let mut steps = Steps::default();
    let mut samples = Vec::new();
    for difference in differences {
        steps = std::array::from_fn(|i| steps[i].wrapping_add(difference[i]));
        samples.push(from_steps(steps)?);
    }
    Ok(samples)
}

fn to_steps(sample: &Sample) -> Steps {
    [
        i64::from(sample.t_ms),
        rounded(sample.width_mm, STEPS_PER_MM),
        rounded(sample.speed_mm_s, STEPS_PER_MM_S),
        rounded(sample.force_n, STEPS_PER_N),
    ]
}

/// Nearest number of steps.
fn rounded(value: f32, steps_per_unit: f64) -> i64 {
    (f64::from(value) * steps_per_unit).round() as i64
}

fn from_steps([t_ms, width, speed, force]: Steps) -> Result<Sample, NoCurve> {
    Ok(Sample {
        t_ms: u32::try_from(t_ms).map_err(|_| NoCurve)?,
        width_mm: value_of(width, STEPS_PER_MM),
        speed_mm_s: value_of(speed, STEPS_PER_MM_S),
        force_n: value_of(force, STEPS_PER_N),
    })
}

fn value_of(steps: i64, steps_per_unit: f64) -> f32 {
    (steps as f64 / steps_per_unit) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(t_ms: u32) -> Sample {
        let t = t_ms as f32;
        Sample { t_ms, width_mm: 60.0 - t / 50.0, speed_mm_s: -20.0, force_n: t * 0.013 }
    }

    #[test]
    fn curve_is_small_and_exact_to_a_step() {
        let curve: Vec<_> = (0..1000).map(|i| sample(i * 10)).collect();
        let bytes = encode(&curve);
        assert!(bytes.len() < 6 * curve.len(), "{} bytes", bytes.len());
        for (sample, decoded) in curve.iter().zip(decode(&bytes).unwrap()) {
            assert_eq!(sample.t_ms, decoded.t_ms);
            assert!((sample.width_mm - decoded.width_mm).abs() <= 0.0006, "{sample:?} {decoded:?}");
            assert!((sample.speed_mm_s - decoded.speed_mm_s).abs() <= 0.006, "{sample:?} {decoded:?}");
            assert!((sample.force_n - decoded.force_n).abs() <= 0.006, "{sample:?} {decoded:?}");
        }
        assert_eq!(decode(&encode(&[])), Ok(Vec::new()));
    }

    #[test]
    fn undecodable_bytes_are_an_error() {
        let bytes = encode(&[sample(0), sample(10)]);
        assert_eq!(decode(&bytes[..bytes.len() - 1]), Err(NoCurve));
        assert_eq!(decode(&[&bytes[..], &[0]].concat()), Err(NoCurve));
        assert_eq!(decode(&[]), Err(NoCurve));
        assert_eq!(decode(&encode(&[sample(5)])[..1]), Err(NoCurve));
        // A vector with a length beyond memory.
        assert_eq!(decode(&[0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x7F]), Err(NoCurve));
        let wild = Sample { t_ms: u32::MAX, width_mm: f32::INFINITY, speed_mm_s: f32::MIN, force_n: f32::NAN };
        assert!(decode(&encode(&[wild, sample(0), wild])).is_ok());
    }
}
