//! JSON names of enum values, for logs and metrics.

use super::{FastStopCause, Kind, Outcome};

macro_rules! names {
    ($($type:ty)*) => {$(
        impl $type {
            /// Name of the value in JSON.
            #[must_use]
            pub fn name(self) -> &'static str {
                self.into()
            }
        }
    )*};
}

names! { Kind Outcome FastStopCause }

#[cfg(test)]
mod tests {
    use strum::VariantArray as _;

    use super::*;

    #[test]
    fn names_match_json() {
        for kind in Kind::VARIANTS {
            assert_eq!(serde_json::json!(kind), kind.name());
        }
        for outcome in Outcome::VARIANTS {
            assert_eq!(serde_json::json!(outcome), outcome.name());
        }
        for cause in FastStopCause::VARIANTS {
            assert_eq!(serde_json::json!(cause), cause.name());
        }
    }
}
