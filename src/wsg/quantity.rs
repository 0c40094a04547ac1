//! Physical quantities as encoded on the wire: finite IEEE 754 singles, each with its unit in its type.
//!
//! Constructors reject NaN and the infinities, because no command defines a meaning for them.

use std::fmt;

/// A number that is not finite, where a quantity was expected.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{value} is not a finite number")]
pub struct NotFinite {
    /// The rejected value.
    pub value: f32,
}

macro_rules! quantities {
    ($($(#[$doc:meta])* $name:ident $unit_fn:ident $unit:literal;)*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
        pub struct $name(f32);

        impl $name {
            /// The quantity 0.
            pub const ZERO: Self = Self(0.0);

            #[doc = concat!("A quantity of `value` ", $unit, ".")]
            ///
            /// # Errors
            /// [`NotFinite`] for NaN and the infinities.
            pub fn new(value: f32) -> Result<Self, NotFinite> {
                if value.is_finite() { Ok(Self(value)) } else { Err(NotFinite { value }) }
            }

            #[doc = concat!("The value in ", $unit, ".")]
            #[must_use]
            pub const fn $unit_fn(self) -> f32 {
                self.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!("{} ", $unit), self.0)
            }
        }
    )*};
}

quantities! {
    /// An opening width, or a change of it: the distance between the base jaws.
    Width mm "mm";
    /// The speed of the fingers, relative to each other.
    Speed mm_s "mm/s";
    /// The acceleration of the fingers.
    Acceleration mm_s2 "mm/s²";
    /// A gripping force: the sum over the fingers.
    Force n "N";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[allow(clippy::float_cmp, reason = "nothing is computed")]
    fn rejects_non_finite_values() {
        assert!(Width::new(f32::NAN).is_err());
        assert!(Speed::new(f32::INFINITY).is_err());
        assert_eq!(Force::new(40.0).unwrap().to_string(), "40 N");
        assert_eq!(Width::new(-1.5).unwrap().mm(), -1.5);
    }
}
