//! Times in JSON: RFC 3339 in UTC, always with three decimals. All have the same length, so their texts sort by time.

use jiff::Timestamp;
use serde::Serializer;

pub fn milliseconds<S: Serializer>(at: &Timestamp, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&format_args!("{at:.3}"))
}

/// Times of measurement, with six decimals.
#[allow(clippy::ref_option, reason = "serde's signature")]
pub fn microseconds_or_null<S: Serializer>(at: &Option<Timestamp>, serializer: S) -> Result<S::Ok, S::Error> {
    match at {
        Some(at) => serializer.collect_str(&format_args!("{at:.6}")),
        None => serializer.serialize_none(),
    }
}

#[allow(clippy::ref_option, reason = "serde's signature")]
pub fn milliseconds_or_null<S: Serializer>(at: &Option<Timestamp>, serializer: S) -> Result<S::Ok, S::Error> {
    match at {
        Some(at) => milliseconds(at, serializer),
        None => serializer.serialize_none(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_three_decimals() {
        for (ms, expected) in [(0, "000"), (500, "500"), (330, "330"), (7, "007")] {
            let at = Timestamp::from_millisecond(1_795_258_800_000 + ms).unwrap();
            let text = milliseconds(&at, serde_json::value::Serializer).unwrap();
            assert_eq!(text, format!("2026-11-21T11:00:00.{expected}Z"));
        }
    }
}
