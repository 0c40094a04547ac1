//! Sessions of browsers, which begin with a token and end by sign-out or when idle.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::credential::SessionId;
use super::token_file::TokenHash;

/// Maximum number of sessions.
const MAX_SESSIONS: usize = 256;

/// Maximum number of sessions of one token.
const MAX_PER_TOKEN: usize = 16;

#[derive(Debug)]
pub(super) struct Sessions {
    idle_time: Duration,
    open: Mutex<HashMap<SessionId, Session>>,
}

#[derive(Debug)]
struct Session {
    token: TokenHash,
    used: Instant,
}

impl Sessions {
    pub(super) fn new(idle_time: Duration) -> Self {
        Self { idle_time, open: Mutex::default() }
    }

    pub(super) fn begin(&self, now: Instant, token: TokenHash) -> Result<SessionId, ring::error::Unspecified> {
        let id = SessionId::generate()?;
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        open.retain(|_, session| now.duration_since(session.used) <= self.idle_time);
        let own = || open.iter().filter(|(_, session)| session.token == token);
        let is_full = open.len() >= MAX_SESSIONS;
        if own().count() >= MAX_PER_TOKEN || is_full {
            // A token's further sessions replace its own before those of others.
            let oldest = own().min_by_key(|(_, session)| session.used);
            let oldest = oldest.or_else(|| open.iter().min_by_key(|(_, session)| session.used));
            if let Some(oldest) = oldest.map(|(id, _)| id.clone()) {
                open.remove(&oldest);
            }
        }
        open.insert(id.clone(), Session { token, used: now });
        Ok(id)
    }

    /// Returns the token of a session that has not been idle for too long.
    pub(super) fn token(&self, now: Instant, id: &SessionId) -> Option<TokenHash> {
        let open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        open.get(id).filter(|session| now.duration_since(session.used) <= self.idle_time).map(|session| session.token)
    }

    /// Returns the token of a session, and counts as a use of the session.
    pub(super) fn used(&self, now: Instant, id: &SessionId) -> Option<TokenHash> {
        let token = self.token(now, id)?;
        if let Some(session) = self.open.lock().unwrap_or_else(PoisonError::into_inner).get_mut(id) {
            session.used = now;
        }
        Some(token)
    }

    pub(super) fn end(&self, id: &SessionId) {
        self.open.lock().unwrap_or_else(PoisonError::into_inner).remove(id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HASH: TokenHash = TokenHash([7; 32]);

    #[test]
    fn session_ends_when_idle_or_signed_out() {
        let (sessions, start) = (Sessions::new(Duration::from_mins(10)), Instant::now());
        let [idle, used, signed_out] = [(); 3].map(|()| sessions.begin(start, HASH).unwrap());
        let soon = start + Duration::from_mins(9);
        assert_eq!(sessions.used(soon, &used), Some(HASH));
        sessions.end(&signed_out);
        assert_eq!(sessions.token(soon, &signed_out), None);
        let later = start + Duration::from_mins(11);
        assert_eq!((sessions.token(later, &used), sessions.token(later, &idle)), (Some(HASH), None));
    }

    #[test]
    fn further_sessions_of_a_token_replace_its_own() {
        let (sessions, start) = (Sessions::new(Duration::from_mins(10)), Instant::now());
        let other = sessions.begin(start, TokenHash([0; 32])).unwrap();
        let first = sessions.begin(start, HASH).unwrap();
        for after in 1..=MAX_SESSIONS as u64 {
            sessions.begin(start + Duration::from_millis(after), HASH).unwrap();
        }
        assert_eq!((sessions.token(start, &first), sessions.token(start, &other)), (None, Some(TokenHash([0; 32]))));
        assert_eq!(sessions.open.lock().unwrap().len(), MAX_PER_TOKEN + 1);
    }

    #[test]
    fn sessions_are_bounded() {
        let (sessions, start) = (Sessions::new(Duration::from_mins(10)), Instant::now());
        for token in 0..=u8::MAX {
            sessions.begin(start, TokenHash([token; 32])).unwrap();
        }
        sessions.begin(start, TokenHash([0xAA; 32])).unwrap();
        assert_eq!(sessions.open.lock().unwrap().len(), MAX_SESSIONS);
    }
}
