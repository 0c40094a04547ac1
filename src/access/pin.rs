//! PINs, which give the session of a shared panel a person's name, role and grippers.

use std::fmt;
use std::str::FromStr;

use ring::error::Unspecified;

use super::random::secret_bytes;

/// Digits of a PIN.
const DIGITS: usize = 6;

/// A PIN of six digits. It is weak, so it is only accepted within a session, and wrong ones are counted. Debug output
/// hides it.
#[derive(Clone, PartialEq, Eq)]
pub struct Pin(String);

/// A text that is not a PIN.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not a PIN: a PIN has {DIGITS} digits")]
pub struct NotAPin;

impl Pin {
    /// Generates a PIN.
    ///
    /// # Errors
    /// The operating system has no random numbers.
    pub fn generate() -> Result<Self, Unspecified> {
        // The first 16 bytes are uniform over far more than all PINs, so the remainder is uniform enough.
        let number = secret_bytes()?.iter().take(16).fold(0, |sum: u128, byte| sum << 8 | u128::from(*byte));
        Ok(Self(format!("{:0DIGITS$}", number % 10_u128.pow(DIGITS as u32))))
    }

    /// The digits, to be shown once or to be hashed.
    #[must_use]
    pub fn expose(&self) -> &str {
        &self.0
    }
}

impl FromStr for Pin {
    type Err = NotAPin;

    fn from_str(text: &str) -> Result<Self, NotAPin> {
        let is_pin = text.len() == DIGITS && text.bytes().all(|byte| byte.is_ascii_digit());
        is_pin.then(|| Self(text.to_owned())).ok_or(NotAPin)
    }
}

impl fmt::Debug for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("…")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pin_has_six_digits() {
        let pin = Pin::generate().unwrap();
        assert_eq!(pin.expose().parse(), Ok(pin.clone()));
        assert_eq!(format!("{pin:?}"), "…");
        for wrong in ["", "12345", "1234567", "12345a", "-12345", "１２３４５６"] {
            assert_eq!(wrong.parse::<Pin>(), Err(NotAPin), "{wrong}");
        }
    }
}
