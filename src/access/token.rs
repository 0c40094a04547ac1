//! The secret text of a token.

use std::fmt;
use std::str::FromStr;

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;

use super::random::{SECRET_BYTES, secret_bytes};

/// Beginning of every token, so that scanners for leaked secrets find it.
const PREFIX: &str = "wsg_";

/// Length of every token: the prefix, and 32 bytes in Base64.
const CHARACTERS: usize = 47;

/// A token: `wsg_` and 43 characters. Debug output hides it.
#[derive(Clone, PartialEq, Eq)]
pub struct TokenSecret(String);

/// A text that is not a token.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("this is not a token; tokens have {CHARACTERS} characters and begin with {PREFIX}: copy it again")]
pub struct NotAToken;

impl TokenSecret {
    /// Generates a token.
    ///
    /// # Errors
    /// The operating system has no random numbers.
    pub fn generate() -> Result<Self, ring::error::Unspecified> {
        Ok(Self(format!("{PREFIX}{}", URL_SAFE_NO_PAD.encode(secret_bytes()?))))
    }

    /// The text, to be shown once or to be hashed.
    #[must_use]
    pub fn expose(&self) -> &str {
        &self.0
    }
}

impl FromStr for TokenSecret {
    type Err = NotAToken;

    fn from_str(text: &str) -> Result<Self, NotAToken> {
        let secret = text.strip_prefix(PREFIX).and_then(|rest| URL_SAFE_NO_PAD.decode(rest).ok());
        secret.filter(|secret| secret.len() == SECRET_BYTES).map(|_| Self(text.to_owned())).ok_or(NotAToken)
    }
}

impl fmt::Debug for TokenSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{PREFIX}…")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn token_is_hidden_in_debug_output() {
        let token = TokenSecret::generate().unwrap();
        assert_eq!((token.expose().len(), format!("{token:?}").as_str()), (CHARACTERS, "wsg_…"));
        assert_eq!(token.expose().parse(), Ok(token.clone()));
        assert_ne!(TokenSecret::generate().unwrap(), token);
    }

    #[test]
    fn other_text_is_no_token() {
        for text in ["", "wsg_", "wsg_abc", "Bearer", &"wsg_".repeat(12), &format!("wsg_{}", "ä".repeat(43))] {
            assert_eq!(text.parse::<TokenSecret>(), Err(NotAToken), "{text}");
        }
    }
}
