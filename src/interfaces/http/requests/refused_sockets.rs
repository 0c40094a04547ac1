//! Log of refused WebSockets. The page or program behind one learns no reason from its WebSocket library, so the reason
//! and its remedy are in the log.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::http::HeaderMap;
use axum::http::header::{HOST, HeaderName, ORIGIN};

use super::problem::RefusedMark;

/// Minimum interval between two lines. Clients repeat refused handshakes every few seconds.
const LOGGED_EVERY: Duration = Duration::from_mins(1);

/// Interval of lines about the same client and reason.
const SAME_LOGGED_EVERY: Duration = Duration::from_hours(1);

/// Characters of a header in a line.
const MAX_SHOWN: usize = 128;

/// Limits the log of refused WebSockets.
#[derive(Debug, Default)]
pub struct RefusedSockets(Mutex<Option<LastLine>>);

/// The last line of the log, and the refusals since.
#[derive(Debug)]
struct LastLine {
    at: Instant,
    client: String,
    code: String,
    unlogged: u64,
}

impl RefusedSockets {
    /// Logs a refused WebSocket of `client`, unless there was a line about the same reason a short time ago.
    pub fn note(&self, client: &str, headers: &Handshake, refused: &RefusedMark) {
        let RefusedMark { code, cause, .. } = refused;
        let Some(unlogged) = self.take_turn(Instant::now(), client, code) else { return };
        let Handshake { host, origin } = headers;
        tracing::warn!(client, code, host, origin, unlogged, "WebSocket refused: {cause}");
    }

    /// Counts a refusal. Returns the number of refusals since the last line if it is time for another line.
    fn take_turn(&self, now: Instant, client: &str, code: &str) -> Option<u64> {
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut unlogged = 0;
        if let Some(last) = last.as_mut() {
            let is_same = last.client == client && last.code == code;
            let interval = if is_same { SAME_LOGGED_EVERY } else { LOGGED_EVERY };
            if now.duration_since(last.at) < interval {
                last.unlogged += 1;
                return None;
            }
            unlogged = last.unlogged;
        }
        *last = Some(LastLine { at: now, client: client.to_owned(), code: code.to_owned(), unlogged: 0 });
        Some(unlogged)
    }
}

/// The headers of a handshake that decide about it, shortened for the log.
#[derive(Debug)]
pub struct Handshake {
    host: Option<String>,
    origin: Option<String>,
}

impl Handshake {
    pub fn of(headers: &HeaderMap) -> Self {
        Self { host: text(headers, &HOST), origin: text(headers, &ORIGIN) }
    }
}

fn text(headers: &HeaderMap, name: &HeaderName) -> Option<String> {
    headers.get(name).map(|value| String::from_utf8_lossy(value.as_bytes()).chars().take(MAX_SHOWN).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_about_repeated_refusals_are_rare() {
        let refused = RefusedSockets::default();
        let start = Instant::now();
        let after = |seconds, client| refused.take_turn(start + Duration::from_secs(seconds), client, "foreign_origin");
        assert_eq!(after(0, "http:10.0.0.5"), Some(0));
        assert_eq!(after(3, "http:10.0.0.5"), None);
        assert_eq!(after(6, "http:10.0.0.6"), None, "another client within a minute");
        assert_eq!(after(60, "http:10.0.0.6"), Some(2));
        assert_eq!(after(120, "http:10.0.0.6"), None, "the same client within an hour");
        assert_eq!(after(3660, "http:10.0.0.6"), Some(1));
    }
}
