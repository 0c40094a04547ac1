//! Sessions of browsers, which begin with a token and end by sign-out or when idle.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::credential::SessionId;
use super::token_file::TokenHash;

/// Maximum number of sessions. A further one ends the session that was unused for the longest time.
const MAX_SESSIONS: usize = 256;

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
        if open.len() >= MAX_SESSIONS
            && let Some(oldest) = open.iter().min_by_key(|(_, session)| session.used).map(|(id, _)| id.clone())
        {
            open.remove(&oldest);
        }
        open.insert(id.clone(), Session { token, used: now });
        Ok(id)
    }

    /// Returns the token of a session that is in use, and counts as its use.
    pub(super) fn token(&self, now: Instant, id: &SessionId) -> Option<TokenHash> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let session = open.get_mut(id).filter(|session| now.duration_since(session.used) <= self.idle_time)?;
        session.used = now;
        Some(session.token)
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
        assert_eq!(sessions.token(soon, &used), Some(HASH));
        sessions.end(&signed_out);
        assert_eq!(sessions.token(soon, &signed_out), None);
        let later = start + Duration::from_mins(11);
        assert_eq!((sessions.token(later, &used), sessions.token(later, &idle)), (Some(HASH), None));
    }

    #[test]
    fn sessions_are_bounded() {
        let (sessions, start) = (Sessions::new(Duration::from_mins(10)), Instant::now());
        let first = sessions.begin(start, HASH).unwrap();
        for after in 1..=MAX_SESSIONS as u64 {
            sessions.begin(start + Duration::from_millis(after), HASH).unwrap();
        }
        assert_eq!(sessions.token(start, &first), None);
        assert_eq!(sessions.open.lock().unwrap().len(), MAX_SESSIONS);
    }
}
