//! Credentials that expire, and the notice that people get before they do.

use std::fmt;
use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};

/// Time before the end at which people get a notice.
const NOTICE: SignedDuration = SignedDuration::from_hours(14 * 24);

/// A token or a certificate that expires.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExpiringCredential {
    pub kind: CredentialKind,
    /// Name of the token, or file of the certificate.
    pub name: Arc<str>,
    pub valid_from: Timestamp,
    pub expires_at: Timestamp,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CredentialKind {
    Token,
    Certificate,
    /// A certificate that the gateway renews itself.
    RenewedCertificate,
}

impl ExpiringCredential {
    #[must_use]
    pub fn has_expired(&self, now: Timestamp) -> bool {
        self.expires_at <= now
    }

    /// Whether a person has to act by now. A token for a few days was meant to end soon.
    #[must_use]
    pub fn needs_attention(&self, now: Timestamp) -> bool {
        let is_short = self.expires_at.duration_since(self.valid_from) <= NOTICE;
        let is_near = self.expires_at.duration_since(now) <= NOTICE;
        is_near && !is_short
    }

    /// Says when the credential ends or ended, and the remedy.
    #[must_use]
    pub fn notice(&self, now: Timestamp) -> String {
        let verb = if self.has_expired(now) { "expired" } else { "expires" };
        let remedy = match self.kind {
            CredentialKind::Token => "create another token, give it to the client, then revoke this one",
            CredentialKind::Certificate => "replace the certificate",
            CredentialKind::RenewedCertificate => {
                "the gateway renews it within the last day; clients that trust exactly this certificate then need the new one"
            }
        };
        format!("{verb} on {:.0}: {remedy}", self.expires_at)
    }
}

impl fmt::Display for CredentialKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Token => "token",
            Self::Certificate | Self::RenewedCertificate => "certificate",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOON: &str = "2026-11-29T12:00:00Z";

    /// A token that is valid between two times, in days from noon.
    fn token(from_days: i64, to_days: i64) -> ExpiringCredential {
        let noon: Timestamp = NOON.parse().unwrap();
        ExpiringCredential {
            kind: CredentialKind::Token,
            name: "plc7".into(),
            valid_from: noon + SignedDuration::from_hours(from_days * 24),
            expires_at: noon + SignedDuration::from_hours(to_days * 24),
        }
    }

    #[test]
    fn people_get_a_notice_fourteen_days_before_the_end() {
        let now: Timestamp = NOON.parse().unwrap();
        assert!(!token(-75, 15).needs_attention(now));
        assert!(token(-76, 14).needs_attention(now) && token(-100, -10).needs_attention(now));
        assert!(!token(0, 1).needs_attention(now), "a token for a day is meant to end soon");
        assert!(token(-76, 14).notice(now).starts_with("expires on 2026-12-13T12:00:00Z: create another token"));
        assert!(token(-100, 0).notice(now).starts_with("expired on 2026-11-29T12:00:00Z: "));
    }
}
