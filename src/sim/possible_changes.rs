//! Validation of changes against the limits of the device and the range of its frames.

use wsg::SystemLimits;

use super::Change;
use super::motion::world::{RIGID_N_MM, SOFTEST_N_MM};

/// Absolute zero and the largest value of 46h, in °C.
const TEMPERATURES_C: [f64; 2] = [-273.1, i16::MAX as f64 / 10.0];

/// A change with a value outside the possible range.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{field} is {value}; it must be from {min} to {max}")]
pub struct ImpossibleChange {
    pub field: &'static str,
    pub value: f64,
    pub min: f64,
    pub max: f64,
}

impl Change {
    /// Checks whether the change can happen to a device with these limits.
    ///
    /// # Errors
    /// [`ImpossibleChange`] for the first field that is out of range.
    pub fn check(&self, limits: &SystemLimits) -> Result<(), ImpossibleChange> {
        let widths = [0.0, f64::from(limits.stroke.mm())];
        match *self {
            Self::PlacePart(part) => {
                within("width_mm", part.width_mm, widths)?;
                within("stiffness_n_mm", part.stiffness_n_mm, [SOFTEST_N_MM, RIGID_N_MM])
            }
            Self::ResizePart { width_mm } | Self::PlaceObstacle { width_mm } => within("width_mm", width_mm, widths),
            Self::Overheat { temperature_c } => within("temperature_c", temperature_c, TEMPERATURES_C),
            Self::FingerOverCurrent { finger, .. } | Self::FingerCommunicationFault { finger, .. } => {
                within("finger", finger.into(), [1.0, 2.0])
            }
            Self::MoveBySomebody { width_mm, speed_mm_s } => {
                within("width_mm", width_mm, widths)?;
                let speeds = [limits.min_speed, limits.max_speed].map(|speed| speed.mm_s().into());
                within("speed_mm_s", speed_mm_s, speeds)
            }
            Self::Fault { times, .. } => within("times", times.into(), [1.0, u32::MAX.into()]),
            _ => Ok(()),
        }
    }
}

/// Checks that `value` is within a range; NaN never is.
fn within(field: &'static str, value: f64, [min, max]: [f64; 2]) -> Result<(), ImpossibleChange> {
    if (min..=max).contains(&value) { Ok(()) } else { Err(ImpossibleChange { field, value, min, max }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DeviceConfig, FaultKind, Part};

    #[test]
    fn impossible_values_are_rejected_with_their_limits() {
        let limits = DeviceConfig::wsg50().limits;
        let soft = Part { stiffness_n_mm: 0.0, ..Part::outside(20.0) };
        for (change, expected) in [
            (Change::PlacePart(Part::outside(-1.0)), "width_mm is -1; it must be from 0 to 110"),
            (Change::PlacePart(Part::inside(f64::NAN)), "width_mm is NaN; it must be from 0 to 110"),
            (Change::PlacePart(soft), "stiffness_n_mm is 0; it must be from 0.1 to 2000"),
            (Change::ResizePart { width_mm: 110.1 }, "width_mm is 110.1; it must be from 0 to 110"),
            (Change::PlaceObstacle { width_mm: f64::INFINITY }, "width_mm is inf; it must be from 0 to 110"),
            (Change::Overheat { temperature_c: 3276.8 }, "temperature_c is 3276.8; it must be from -273.1 to 3276.7"),
            (Change::FingerOverCurrent { finger: 0, on: true }, "finger is 0; it must be from 1 to 2"),
            (Change::FingerCommunicationFault { finger: 3, on: true }, "finger is 3; it must be from 1 to 2"),
            (Change::MoveBySomebody { width_mm: 20.0, speed_mm_s: 0.0 }, "speed_mm_s is 0; it must be from 5 to 420"),
            (
                Change::Fault { kind: FaultKind::NoReply, id: None, times: 0 },
                "times is 0; it must be from 1 to 4294967295",
            ),
        ] {
            assert_eq!(change.check(&limits).unwrap_err().to_string(), expected);
        }
        for change in [
            Change::PlacePart(Part::outside(110.0)),
            Change::Overheat { temperature_c: -20.0 },
            Change::MoveBySomebody { width_mm: 0.0, speed_mm_s: 420.0 },
            Change::CutConnection,
        ] {
            assert_eq!(change.check(&limits), Ok(()), "{change:?}");
        }
    }
}
