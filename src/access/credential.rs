//! The credentials that clients present.

use std::fmt;

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;

use super::random::secret_bytes;
use super::token::{NotAToken, TokenSecret};

/// A credential, as a client presents it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Credential {
    /// Nothing; its address can still identify the client.
    None,
    Token(TokenSecret),
    Session(SessionId),
    /// A header that cannot be parsed.
    Malformed,
    /// A text in the place of a token.
    NotAToken(NotAToken),
    /// A ticket that is not valid, or no longer. A valid one stands for its own credential.
    InvalidTicket,
}

impl Credential {
    /// Parses the text that a client presents as a token.
    #[must_use]
    pub fn of_token(text: &str) -> Self {
        text.parse().map_or_else(Self::NotAToken, Self::Token)
    }
}

/// Secret id of a browser's session. Debug output hides it.
#[derive(Clone, PartialEq, Eq, Hash)]
pub struct SessionId(String);

impl SessionId {
    /// Length of the text: 32 bytes in Base64.
    const CHARACTERS: usize = 43;

    pub(super) fn generate() -> Result<Self, ring::error::Unspecified> {
        Ok(Self(URL_SAFE_NO_PAD.encode(secret_bytes()?)))
    }

    /// Parses the value of a cookie.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        (text.len() == Self::CHARACTERS && text.is_ascii()).then(|| Self(text.to_owned()))
    }

    /// The text for the cookie.
    #[must_use]
    pub fn expose(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("…")
    }
}
