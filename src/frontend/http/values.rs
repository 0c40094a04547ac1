//! Numbers and texts from clients: within bounds, and as the wire's quantities.
//!
//! The quantities' bounds are those of the document, far outside what any gripper can do; what its own limits are, the
//! gripper knows. They keep a slip of ten powers out whatever state the gripper is in.

use std::ops::RangeInclusive;

use super::errors::Problem;
use crate::gripper::model::Text;
use crate::wsg::{Acceleration, Force, NotFinite, Speed, Width};

const WIDTH_MM: RangeInclusive<f64> = 0.0..=1000.0;
const OFFSET_MM: RangeInclusive<f64> = -1000.0..=1000.0;
const SPEED_MM_S: RangeInclusive<f64> = 0.0..=10_000.0;
const ACCELERATION_MM_S2: RangeInclusive<f64> = 0.0..=1_000_000.0;
const FORCE_N: RangeInclusive<f64> = 0.0..=10_000.0;

/// An opening width, in mm.
pub fn width(field: &str, mm: f64) -> Result<Width, Problem> {
    Width::new(single(field, mm, WIDTH_MM)?).map_err(|error| not_finite(field, error))
}

/// An opening width, or a change of it, in mm.
pub fn width_or_offset(field: &str, mm: f64) -> Result<Width, Problem> {
    Width::new(single(field, mm, OFFSET_MM)?).map_err(|error| not_finite(field, error))
}

/// A speed, in mm/s.
pub fn speed(field: &str, mm_s: f64) -> Result<Speed, Problem> {
    Speed::new(single(field, mm_s, SPEED_MM_S)?).map_err(|error| not_finite(field, error))
}

/// An acceleration, in mm/s².
pub fn acceleration(field: &str, mm_s2: f64) -> Result<Acceleration, Problem> {
    Acceleration::new(single(field, mm_s2, ACCELERATION_MM_S2)?).map_err(|error| not_finite(field, error))
}

/// A force, in N.
pub fn force(field: &str, n: f64) -> Result<Force, Problem> {
    Force::new(single(field, n, FORCE_N)?).map_err(|error| not_finite(field, error))
}

fn not_finite(field: &str, error: NotFinite) -> Problem {
    Problem::malformed(field, format!("{field}: {error}"))
}

/// A JSON number that must be whole, which 96.0 is.
pub fn integer(field: &str, number: f64, range: RangeInclusive<u64>) -> Result<u64, Problem> {
    if !number.is_finite() || number.fract() != 0.0 {
        let value = serde_json::Number::from_f64(number).map(serde_json::Value::Number);
        return Err(Problem::malformed(field, format!("{field} must be a whole number")).value(value));
    }
    let (min, max) = (*range.start() as f64, *range.end() as f64);
    if (min..=max).contains(&number) {
        // Inside the range, so nothing is lost.
        Ok(number as u64)
    } else {
        Err(Problem::out_of_range(field, number, min, max))
    }
}

/// A JSON number as a single, if it is inside the bounds that the document states for its field.
pub fn single(field: &str, number: f64, range: RangeInclusive<f64>) -> Result<f32, Problem> {
    if range.contains(&number) {
        Ok(number as f32)
    } else {
        Err(Problem::out_of_range(field, number, *range.start(), *range.end()))
    }
}

/// Text from a client, within its field's bounds.
pub fn text<const MAX: usize>(field: &str, given: &str) -> Result<Text<MAX>, Problem> {
    if given.len() > MAX {
        return Err(Problem::too_long(field, given.len(), MAX));
    }
    Text::new(given).ok_or_else(|| Problem::malformed(field, format!("{field} must have no control characters")))
}

/// Bytes in hexadecimal digits.
pub fn bytes(field: &str, given: &str, max: usize) -> Result<Vec<u8>, Problem> {
    let bytes = hex::decode(given).map_err(|error| Problem::malformed(field, format!("{field} is no hex: {error}")))?;
    if bytes.len() <= max { Ok(bytes) } else { Err(Problem::too_long(field, bytes.len(), max)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_beyond_the_documents_bounds_is_out_of_range() {
        assert!(single("width_mm", 96.0, 0.0..=1000.0).is_ok());
        for beyond in [-0.1, 1000.1, 1e39, f64::INFINITY, f64::NAN] {
            assert_eq!(single("width_mm", beyond, 0.0..=1000.0).unwrap_err().status().as_u16(), 422, "{beyond}");
        }
    }

    #[test]
    fn bytes_are_hex() {
        assert_eq!(bytes("data", "00ffA0", 3).unwrap(), [0x00, 0xFF, 0xA0]);
        assert_eq!(bytes("data", "00ff", 1).unwrap_err().status().as_u16(), 422);
        for wrong in ["0", "0g", "0x00", "00 01"] {
            assert_eq!(bytes("data", wrong, 16).unwrap_err().status().as_u16(), 400, "{wrong}");
        }
    }

    #[test]
    fn the_document_states_the_bounds_that_hold() {
        let document = serde_json::to_value(super::super::openapi()).unwrap();
        let stated = |schema: &str, field: &str| {
            let field = &document["components"]["schemas"][schema]["properties"][field];
            field["minimum"].as_f64().unwrap()..=field["maximum"].as_f64().unwrap()
        };
        assert_eq!(stated("Move", "width_mm"), OFFSET_MM);
        assert_eq!(stated("Move", "speed_mm_s"), SPEED_MM_S);
        for schema in ["Grip", "Release"] {
            assert_eq!(stated(schema, "width_mm"), WIDTH_MM);
            assert_eq!(stated(schema, "speed_mm_s"), SPEED_MM_S);
        }
        assert_eq!(stated("Grip", "force_n"), FORCE_N);
        assert_eq!(stated("ForceLimitSetting", "force_n"), FORCE_N);
        assert_eq!(stated("AccelerationSetting", "acceleration_mm_s2"), ACCELERATION_MM_S2);
        assert_eq!(stated("SoftLimitsSetting", "minus_mm"), WIDTH_MM);
        assert_eq!(stated("SoftLimitsSetting", "plus_mm"), WIDTH_MM);
    }
}
