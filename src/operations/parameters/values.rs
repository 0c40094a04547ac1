//! Numbers and texts from clients, checked and converted to the wire's quantities.
//!
//! A number only has to fit the wire here; the gripper checks its own limits. The bounds in the OpenAPI document are
//! those that no gripper exceeds.
//!
//! Type names that end in `Field` do not appear in the API's documents: such a type is described where it is used.

use std::borrow::Cow;
use std::fmt;
use std::ops::{Deref, RangeInclusive};

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use serde_json::Number;
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{KnownFormat, ObjectBuilder, OneOfBuilder, Schema, SchemaFormat, Type};
use utoipa::{PartialSchema, ToSchema};

use crate::gripper::limits::{FASTEST_MM_S, HARDEST_MM_S2, STRONGEST_N, WIDEST_MM};
use crate::model::{Name, PartId, ShownName, Text};
use crate::operations::problem::Problem;
use crate::wsg::{Acceleration, Force, NotFinite, Speed, Width};

/// Token of the current lease, if the gripper is leased. At most 64 bytes; empty means none.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(transparent)]
#[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
pub struct LeaseField(String);

impl Deref for LeaseField {
    type Target = str;

    fn deref(&self) -> &str {
        &self.0
    }
}

/// Cuts a client's text to the 32 characters that an answer repeats.
pub fn shortened(text: &str) -> String {
    text.chars().take(32).collect()
}

/// An opening width, or a change of it, in mm.
pub fn width(field: &str, mm: f64) -> Result<Width, Problem> {
    Width::new(single(field, mm, WIDEST_MM)?).map_err(|error| not_finite(field, error))
}

/// A speed, in mm/s.
pub fn speed(field: &str, mm_s: f64) -> Result<Speed, Problem> {
    Speed::new(single(field, mm_s, FASTEST_MM_S)?).map_err(|error| not_finite(field, error))
}

/// An acceleration, in mm/s².
pub fn acceleration(field: &str, mm_s2: f64) -> Result<Acceleration, Problem> {
    Acceleration::new(single(field, mm_s2, HARDEST_MM_S2)?).map_err(|error| not_finite(field, error))
}

/// A force, in N.
pub fn force(field: &str, n: f64) -> Result<Force, Problem> {
    Force::new(single(field, n, STRONGEST_N)?).map_err(|error| not_finite(field, error))
}

fn not_finite(field: &str, error: NotFinite) -> Problem {
    Problem::malformed(field, format!("{field}: {error}"))
}

/// The name of a gripper or a gateway.
pub fn gripper_or_gateway(field: &str, given: &str) -> Result<Name, Problem> {
    given.parse().map_err(|error| Problem::malformed(field, format!("{field}: {error}")))
}

/// A JSON number that must be whole and from `MIN` to `MAX`; 96.0 counts as whole.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(transparent)]
pub struct Whole<const MIN: u64, const MAX: u64>(f64);

impl<const MIN: u64, const MAX: u64> Whole<MIN, MAX> {
    /// Returns the number.
    ///
    /// # Errors
    /// A problem that names the field and the bounds.
    pub fn checked(self, field: &str) -> Result<u64, Problem> {
        integer(field, self.0, MIN..=MAX)
    }
}

impl<const MIN: u64, const MAX: u64> PartialSchema for Whole<MIN, MAX> {
    fn schema() -> RefOr<Schema> {
        let known = if u8::try_from(MAX).is_ok() { KnownFormat::Int32 } else { KnownFormat::Int64 };
        let number = ObjectBuilder::new().schema_type(Type::Integer).format(Some(SchemaFormat::KnownFormat(known)));
        number.minimum(Some(MIN)).maximum(Some(MAX)).build().into()
    }
}

impl<const MIN: u64, const MAX: u64> ToSchema for Whole<MIN, MAX> {
    fn name() -> Cow<'static, str> {
        format!("WholeFrom{MIN}To{MAX}Field").into()
    }
}

/// Number of a recipe.
pub type GivenNumber = Whole<1, 255>;
/// Number of a recipe, or 0 for none.
pub type RecipeOrNone = Whole<0, 255>;
/// Version of a recipe, or 0 for none.
pub type VersionOrNone = Whole<0, MAX_EXACT>;
/// Version of a recipe.
pub type Version = Whole<1, MAX_EXACT>;

/// Greatest whole number that every JSON parser represents exactly (RFC 8259, 6): 2^53 - 1.
pub const MAX_EXACT: u64 = 9_007_199_254_740_991;

/// A JSON number that must be whole; 96.0 counts as whole.
pub fn integer(field: &str, number: f64, range: RangeInclusive<u64>) -> Result<u64, Problem> {
    if !number.is_finite() || number.fract() != 0.0 {
        let value = serde_json::Number::from_f64(number).map(serde_json::Value::Number);
        return Err(Problem::malformed(field, format!("{field} must be a whole number")).value(value));
    }
    let min = *range.start() as f64;
    let max = *range.end() as f64;
    if (min..=max).contains(&number) {
        // Inside the range, so the cast loses nothing.
        Ok(number as u64)
    } else {
        Err(Problem::out_of_range(field, number, min, max))
    }
}

/// A JSON number in single precision. A number too large for it is beyond all limits.
fn single(field: &str, number: f64, max: f32) -> Result<f32, Problem> {
    let single = number as f32;
    if single.is_finite() { Ok(single) } else { Err(Problem::out_of_range(field, number, 0.0, f64::from(max))) }
}

/// Text from a client, within its field's bounds.
pub fn text<const MAX: usize>(field: &str, given: &str) -> Result<Text<MAX>, Problem> {
    if given.len() > MAX {
        return Err(Problem::too_long(field, given.len(), MAX));
    }
    Text::new(given).ok_or_else(|| Problem::malformed(field, format!("{field} must not contain control characters")))
}

/// Id of a part, which is not empty.
pub fn part_id(field: &str, given: &str) -> Result<PartId, Problem> {
    if given.is_empty() {
        return Err(Problem::malformed(field, format!("{field} must not be empty")));
    }
    text(field, given)
}

/// Name by which people distinguish clients, within its field's bounds.
///
/// # Errors
/// A problem that names the field, what is wrong and the remedy.
pub fn name<const MAX: usize>(field: &str, given: &str) -> Result<ShownName<MAX>, Problem> {
    if given.len() > MAX {
        return Err(Problem::too_long(field, given.len(), MAX));
    }
    ShownName::new(given).map_err(|error| Problem::malformed(field, format!("{field} {error}")))
}

/// A text that a client without string functions can send as a whole number.
#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "expected a string or a whole number")]
pub enum TextOrNumber {
    Text(String),
    Number(#[serde(deserialize_with = "whole")] i64),
}

/// Parses a whole number, also in the form `7.0`.
fn whole<'de, D: Deserializer<'de>>(deserializer: D) -> Result<i64, D::Error> {
    let number = Number::deserialize(deserializer)?;
    if let Some(whole) = number.as_i64() {
        return Ok(whole);
    }
    match number.as_f64() {
        Some(float) if float.fract() == 0.0 && float.abs() < i64::MAX as f64 => Ok(float as i64),
        _ => Err(D::Error::custom("not a whole number")),
    }
}

impl fmt::Display for TextOrNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(text) => f.write_str(text),
            Self::Number(number) => number.fmt(f),
        }
    }
}

/// A text of `MIN` to `MAX` bytes, or a whole number, which is treated as text.
#[derive(Debug, Deserialize)]
#[serde(transparent)]
pub struct ShortText<const MAX: usize, const MIN: usize = 0>(TextOrNumber);

/// Id of a part; empty means none.
pub type PartIdText = ShortText<48>;
/// Id of a part that is given.
pub type FullPartId = ShortText<48, 1>;
/// Id of a finger set.
pub type FingerSetText = ShortText<48, 1>;
/// Id of a request.
pub type RequestIdText = ShortText<64>;

impl<const MAX: usize, const MIN: usize> fmt::Display for ShortText<MAX, MIN> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl<const MAX: usize, const MIN: usize> PartialSchema for ShortText<MAX, MIN> {
    fn schema() -> RefOr<Schema> {
        let text = ObjectBuilder::new().schema_type(Type::String).max_length(Some(MAX));
        let text = text.min_length((MIN > 0).then_some(MIN));
        let text = text.pattern(Some(r"^[^\u0000-\u001f\u007f-\u009f]*$"));
        let number = ObjectBuilder::new().schema_type(Type::Integer).minimum(Some(i64::MIN)).maximum(Some(i64::MAX));
        Schema::OneOf(OneOfBuilder::new().item(text).item(number).build()).into()
    }
}

impl<const MAX: usize, const MIN: usize> ToSchema for ShortText<MAX, MIN> {
    fn name() -> Cow<'static, str> {
        format!("ShortText{MIN}To{MAX}Field").into()
    }
}

/// Bytes in hexadecimal digits.
pub fn bytes(field: &str, given: &str, max: usize) -> Result<Vec<u8>, Problem> {
    let bytes =
        hex::decode(given).map_err(|error| Problem::malformed(field, format!("{field} is not valid hex: {error}")))?;
    if bytes.len() <= max { Ok(bytes) } else { Err(Problem::too_long(field, bytes.len(), max)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_number_can_have_decimals_of_zero() {
        let parsed = |json: &str| serde_json::from_str::<TextOrNumber>(json).ok().map(|value| value.to_string());
        assert_eq!(parsed("-178.0").as_deref(), Some("-178"));
        assert_eq!(parsed("9007199254740993").as_deref(), Some("9007199254740993"));
        assert_eq!(parsed("\"7.5\"").as_deref(), Some("7.5"));
        for wrong in ["7.5", "1e300", "true", "null"] {
            assert_eq!(parsed(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn number_that_does_not_fit_the_wire_is_out_of_range() {
        assert!(width("width_mm", 96.0).is_ok());
        for beyond in [1e39, f64::INFINITY, f64::NAN] {
            assert_eq!(width("width_mm", beyond).unwrap_err().status().as_u16(), 422, "{beyond}");
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
    fn openapi_document_states_the_enforced_bounds() {
        let document = crate::interfaces::http::openapi();
        let stated = |schema: &str, field: &str| {
            let field = &document["components"]["schemas"][schema]["properties"][field];
            (field["minimum"].as_f64().unwrap() as f32, field["maximum"].as_f64().unwrap() as f32)
        };
        assert_eq!(stated("Move", "width_mm"), (-WIDEST_MM, WIDEST_MM));
        assert_eq!(stated("Move", "speed_mm_s"), (0.0, FASTEST_MM_S));
        for schema in ["Grip", "Release"] {
            assert_eq!(stated(schema, "width_mm"), (0.0, WIDEST_MM));
            assert_eq!(stated(schema, "speed_mm_s"), (0.0, FASTEST_MM_S));
        }
        assert_eq!(stated("Grip", "force_n"), (0.0, STRONGEST_N));
        assert_eq!(stated("ForceLimitSetting", "force_n"), (0.0, STRONGEST_N));
        assert_eq!(stated("AccelerationSetting", "acceleration_mm_s2"), (0.0, HARDEST_MM_S2));
        assert_eq!(stated("SoftLimitsSetting", "minus_mm"), (0.0, WIDEST_MM));
        assert_eq!(stated("SoftLimitsSetting", "plus_mm"), (0.0, WIDEST_MM));
    }
}
