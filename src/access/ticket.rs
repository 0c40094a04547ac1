//! Tickets, which stand for a credential once: for web pages, whose WebSockets and streams can send no header.

use std::collections::HashMap;
use std::fmt;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ring::error::Unspecified;

use super::credential::Credential;
use super::random::secret_bytes;

/// Time for which a ticket is valid. It can appear in the log of a proxy, so it is worth nothing soon after.
pub const TICKET_TIME: Duration = Duration::from_secs(30);

/// Maximum number of valid tickets.
const MAX_TICKETS: usize = 1024;

/// Maximum number of valid tickets of one credential.
const MAX_PER_CREDENTIAL: usize = 64;

/// Secret text of a ticket. Debug output hides it.
#[derive(Clone, PartialEq, Eq, Hash)]
pub struct TicketId(String);

impl TicketId {
    fn generate() -> Result<Self, Unspecified> {
        Ok(Self(URL_SAFE_NO_PAD.encode(secret_bytes()?)))
    }

    /// The text for the client.
    #[must_use]
    pub fn expose(&self) -> &str {
        &self.0
    }
}

impl From<&str> for TicketId {
    fn from(text: &str) -> Self {
        Self(text.to_owned())
    }
}

impl fmt::Debug for TicketId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("…")
    }
}

#[derive(Debug, Default)]
pub(super) struct Tickets(Mutex<HashMap<TicketId, HeldCredential>>);

/// The credential behind a ticket.
#[derive(Debug)]
struct HeldCredential {
    credential: Credential,
    issued: Instant,
}

impl Tickets {
    /// Issues a ticket for a credential. Beyond the limits, it replaces the oldest ticket: of the same credential before
    /// those of others.
    pub(super) fn issue(&self, now: Instant, credential: &Credential) -> Result<TicketId, Unspecified> {
        let id = TicketId::generate()?;
        let mut held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        held.retain(|_, held| held.is_valid(now));
        let own: Vec<_> = held.iter().filter(|(_, held)| held.credential == *credential).collect();
        if own.len() >= MAX_PER_CREDENTIAL || held.len() >= MAX_TICKETS {
            let oldest = own.into_iter().min_by_key(|(_, held)| held.issued);
            let oldest = oldest.or_else(|| held.iter().min_by_key(|(_, held)| held.issued));
            if let Some(oldest) = oldest.map(|(id, _)| id.clone()) {
                held.remove(&oldest);
            }
        }
        held.insert(id.clone(), HeldCredential { credential: credential.clone(), issued: now });
        Ok(id)
    }

    /// Takes a ticket, and returns its credential if the ticket is valid.
    pub(super) fn take(&self, now: Instant, id: &TicketId) -> Option<Credential> {
        let held = self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(id)?;
        held.is_valid(now).then_some(held.credential)
    }
}

impl HeldCredential {
    fn is_valid(&self, now: Instant) -> bool {
        now.duration_since(self.issued) < TICKET_TIME
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::TokenSecret;

    fn token() -> Credential {
        Credential::Token(TokenSecret::generate().unwrap())
    }

    #[test]
    fn ticket_is_valid_once_and_for_a_short_time() {
        let tickets = Tickets::default();
        let start = Instant::now();
        let credential = token();
        let [used, late] = [(); 2].map(|()| tickets.issue(start, &credential).unwrap());
        assert_eq!(tickets.take(start, &used), Some(credential));
        assert_eq!(tickets.take(start, &used), None, "used");
        assert_eq!(tickets.take(start + TICKET_TIME, &late), None, "expired");
        assert_eq!(tickets.take(start, &"invented".into()), None);
        assert_eq!(format!("{used:?}"), "…");
    }

    #[test]
    fn further_tickets_of_a_credential_replace_its_own() {
        let tickets = Tickets::default();
        let start = Instant::now();
        let other = tickets.issue(start, &Credential::None).unwrap();
        let credential = token();
        let first = tickets.issue(start, &credential).unwrap();
        for after_ms in 1..=MAX_PER_CREDENTIAL as u64 {
            tickets.issue(start + Duration::from_millis(after_ms), &credential).unwrap();
        }
        assert_eq!(tickets.take(start, &first), None);
        assert_eq!(tickets.take(start, &other), Some(Credential::None));
    }

    #[test]
    fn tickets_are_bounded() {
        let tickets = Tickets::default();
        let start = Instant::now();
        for _ in 0..=MAX_TICKETS {
            tickets.issue(start, &token()).unwrap();
        }
        assert_eq!(tickets.0.lock().unwrap().len(), MAX_TICKETS);
    }
}
