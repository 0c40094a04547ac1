//! Sessions of browsers, which begin with a token and end by sign-out or when idle.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::credential::SessionId;
use super::token_file::TokenHash;
use crate::settings::{between, settings, whole};

/// Maximum number of sessions.
const MAX_SESSIONS: usize = 256;

/// Maximum number of sessions of one token.
const MAX_PER_TOKEN: usize = 16;

/// Wrong PINs that a token's sessions can enter in a row, before they have to wait.
const MAX_WRONG_PINS: u32 = 5;

/// Wait after too many wrong PINs. A million PINs then take almost two years.
const PIN_PAUSE: Duration = Duration::from_mins(5);

settings! {
    /// Times after which idle sessions end.
    #[derive(Copy, Eq)]
    pub struct SessionTimes {
        /// Time in hours after which an idle session of a browser ends.
        pub idle: Duration = "session_idle_h",
            whole(8, between(1..=720, "choose how long an unused browser stays signed in"), Duration::from_hours), Reload;
        /// Time in minutes after which the rights of an unused [PIN](access.md#shared-panels) end.
        pub pin_idle: Duration = "pin_idle_min",
            whole(5, between(1..=480, "choose how long the rights of an unused PIN last"), Duration::from_mins), Reload;
    }
}

#[derive(Debug, Default)]
pub(super) struct Sessions(Mutex<Open>);

#[derive(Debug, Default)]
struct Open {
    sessions: HashMap<SessionId, Session>,
    /// Wrong PINs in a row by the sessions of a token, and the time of the newest.
    wrong_pins: HashMap<TokenHash, (u32, Instant)>,
}

#[derive(Debug)]
struct Session {
    token: TokenHash,
    used: Instant,
    /// The PIN that was entered, and the time at which its rights were used last.
    pin: Option<(TokenHash, Instant)>,
}

/// The credentials behind a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SessionCredentials {
    pub token: TokenHash,
    pub pin: Option<TokenHash>,
}

impl Session {
    fn is_open(&self, now: Instant, times: SessionTimes) -> bool {
        now.duration_since(self.used) <= times.idle
    }

    fn credentials(&self, now: Instant, times: SessionTimes) -> SessionCredentials {
        let pin = self.pin.filter(|(_, used)| now.duration_since(*used) <= times.pin_idle);
        SessionCredentials { token: self.token, pin: pin.map(|(pin, _)| pin) }
    }
}

impl Sessions {
    pub(super) fn begin(
        &self,
        now: Instant,
        times: SessionTimes,
        token: TokenHash,
    ) -> Result<SessionId, ring::error::Unspecified> {
        let id = SessionId::generate()?;
        let open = &mut self.open().sessions;
        open.retain(|_, session| session.is_open(now, times));
        let own_sessions = open.values().filter(|session| session.token == token).count();
        if own_sessions >= MAX_PER_TOKEN || open.len() >= MAX_SESSIONS {
            // A token's further sessions replace its own before those of others.
            let own = open.iter().filter(|(_, session)| session.token == token);
            let oldest = own.min_by_key(|(_, session)| session.used);
            let oldest = oldest.or_else(|| open.iter().min_by_key(|(_, session)| session.used));
            if let Some(oldest) = oldest.map(|(id, _)| id.clone()) {
                open.remove(&oldest);
            }
        }
        open.insert(id.clone(), Session { token, used: now, pin: None });
        Ok(id)
    }

    /// Returns the credentials behind a session that has not been idle for too long.
    pub(super) fn credentials(&self, now: Instant, times: SessionTimes, id: &SessionId) -> Option<SessionCredentials> {
        let open = self.open();
        open.sessions
            .get(id)
            .filter(|session| session.is_open(now, times))
            .map(|session| session.credentials(now, times))
    }

    /// Notes a use of an open session, and of its PIN if `with_pin`.
    pub(super) fn note_use(&self, now: Instant, id: &SessionId, with_pin: bool) {
        let mut open = self.open();
        let Some(session) = open.sessions.get_mut(id) else { return };
        session.used = now;
        if let Some((_, used)) = session.pin.as_mut().filter(|_| with_pin) {
            *used = now;
        }
    }

    /// Counts an attempt to enter a PIN as wrong; [`Self::add_pin`] takes a right one back. Returns `false` if the
    /// sessions of this token have to wait.
    pub(super) fn count_pin_attempt(&self, now: Instant, token: TokenHash) -> bool {
        let mut open = self.open();
        open.wrong_pins.retain(|_, (_, at)| now.duration_since(*at) < PIN_PAUSE);
        let (count, _) = open.wrong_pins.entry(token).or_insert((0, now));
        let may_try = *count < MAX_WRONG_PINS;
        if may_try {
            *count += 1;
        }
        may_try
    }

    /// Notes that a counted attempt was wrong. A right one must not prolong the time for which wrong ones count.
    pub(super) fn note_wrong_pin(&self, now: Instant, token: TokenHash) {
        if let Some((_, at)) = self.open().wrong_pins.get_mut(&token) {
            *at = now;
        }
    }

    /// Gives a session the identity of a PIN, and takes back the attempt that [`Self::count_pin_attempt`] counted.
    pub(super) fn add_pin(&self, now: Instant, id: &SessionId, pin: TokenHash) {
        let mut open = self.open();
        let Some(session) = open.sessions.get_mut(id) else { return };
        session.pin = Some((pin, now));
        let token = session.token;
        if let Some((count, _)) = open.wrong_pins.get_mut(&token) {
            *count = count.saturating_sub(1);
        }
    }

    /// Takes the rights of a PIN away from a session.
    pub(super) fn remove_pin(&self, id: &SessionId) {
        if let Some(session) = self.open().sessions.get_mut(id) {
            session.pin = None;
        }
    }

    pub(super) fn end(&self, id: &SessionId) {
        self.open().sessions.remove(id);
    }

    fn open(&self) -> MutexGuard<'_, Open> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HASH: TokenHash = TokenHash([7; 32]);
    const PIN: TokenHash = TokenHash([8; 32]);
    const TIMES: SessionTimes = SessionTimes { idle: Duration::from_mins(10), pin_idle: Duration::from_mins(1) };

    fn token(sessions: &Sessions, now: Instant, id: &SessionId) -> Option<TokenHash> {
        sessions.credentials(now, TIMES, id).map(|behind| behind.token)
    }

    #[test]
    fn session_ends_when_idle_or_signed_out() {
        let (sessions, start) = (Sessions::default(), Instant::now());
        let [idle, used, signed_out] = [(); 3].map(|()| sessions.begin(start, TIMES, HASH).unwrap());
        let soon = start + Duration::from_mins(9);
        sessions.note_use(soon, &used, false);
        sessions.end(&signed_out);
        assert_eq!(token(&sessions, soon, &signed_out), None);
        let later = start + Duration::from_mins(11);
        assert_eq!((token(&sessions, later, &used), token(&sessions, later, &idle)), (Some(HASH), None));
    }

    #[test]
    fn pin_is_forgotten_when_idle() {
        let (sessions, start) = (Sessions::default(), Instant::now());
        let id = sessions.begin(start, TIMES, HASH).unwrap();
        sessions.add_pin(start, &id, PIN);
        let after = |seconds| start + Duration::from_secs(seconds);
        let pin = |seconds| sessions.credentials(after(seconds), TIMES, &id).unwrap().pin;
        sessions.note_use(after(50), &id, true);
        sessions.note_use(after(100), &id, false);
        assert_eq!([pin(100), pin(111)], [Some(PIN), None]);
        assert_eq!(token(&sessions, after(111), &id), Some(HASH));
    }

    #[test]
    fn wrong_pins_are_slowed() {
        let (sessions, start) = (Sessions::default(), Instant::now());
        let id = sessions.begin(start, TIMES, HASH).unwrap();
        for _ in 0..MAX_WRONG_PINS {
            assert!(sessions.count_pin_attempt(start, HASH));
        }
        // The last attempt was right, so a further one is possible.
        sessions.add_pin(start, &id, PIN);
        assert!(sessions.count_pin_attempt(start, HASH));
        assert!(!sessions.count_pin_attempt(start + PIN_PAUSE / 2, HASH) && sessions.count_pin_attempt(start, PIN));
        assert!(sessions.count_pin_attempt(start + PIN_PAUSE, HASH));
    }

    #[test]
    fn right_pin_does_not_prolong_the_time_of_wrong_ones() {
        let (sessions, start) = (Sessions::default(), Instant::now());
        let id = sessions.begin(start, TIMES, HASH).unwrap();
        let wrong_at = |at| {
            let may_try = sessions.count_pin_attempt(at, HASH);
            sessions.note_wrong_pin(at, HASH);
            may_try
        };
        assert!((1..MAX_WRONG_PINS).all(|_| wrong_at(start)));
        let soon = start + PIN_PAUSE / 2;
        assert!(sessions.count_pin_attempt(soon, HASH));
        sessions.add_pin(soon, &id, PIN);
        let later = start + PIN_PAUSE;
        assert!((0..MAX_WRONG_PINS).all(|_| wrong_at(later)) && !wrong_at(later + PIN_PAUSE / 2));
    }

    #[test]
    fn further_sessions_of_a_token_replace_its_own() {
        let (sessions, start) = (Sessions::default(), Instant::now());
        let other = sessions.begin(start, TIMES, TokenHash([0; 32])).unwrap();
        let first = sessions.begin(start, TIMES, HASH).unwrap();
        for after in 1..=MAX_SESSIONS as u64 {
            sessions.begin(start + Duration::from_millis(after), TIMES, HASH).unwrap();
        }
        let found = (token(&sessions, start, &first), token(&sessions, start, &other));
        assert_eq!(found, (None, Some(TokenHash([0; 32]))));
        assert_eq!(sessions.open().sessions.len(), MAX_PER_TOKEN + 1);
    }

    #[test]
    fn sessions_are_bounded() {
        let (sessions, start) = (Sessions::default(), Instant::now());
        for token in 0..=u8::MAX {
            sessions.begin(start, TIMES, TokenHash([token; 32])).unwrap();
        }
        sessions.begin(start, TIMES, TokenHash([0xAA; 32])).unwrap();
        assert_eq!(sessions.open().sessions.len(), MAX_SESSIONS);
    }
}
