//! The names that JSON has for enums, for logs and metrics.

use super::{FastStopCause, Kind, Outcome};

macro_rules! names {
    ($($type:ty)*) => {$(
        impl $type {
            /// As JSON has it.
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
    fn the_names_are_those_of_the_json() {
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
