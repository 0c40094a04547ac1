//! Serialised updates, and a cache of the recent ones.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use bytes::Bytes;
use serde::Serialize;
use tokio_tungstenite::tungstenite::protocol::frame::Frame;
use tokio_tungstenite::tungstenite::protocol::frame::coding::{Data, OpCode};

use crate::gripper::Now;
use crate::model::State;

/// A JSON-RPC notification in a WebSocket frame, with the update's body as its parameters. Clones share the bytes.
#[derive(Debug, Clone)]
pub struct Notification {
    method: &'static str,
    frame: Bytes,
    /// Position of the body in the frame.
    body: Range<usize>,
}

impl Notification {
    /// Serialises a body. Logs a body that cannot be encoded as JSON, and returns `None`.
    pub fn new(method: &'static str, body: &impl Serialize) -> Option<Self> {
        let json = serde_json::to_string(body)
            .inspect_err(|error| tracing::error!(method, %error, "update cannot be encoded as JSON"));
        Some(Self::of_json(method, &json.ok()?))
    }

    /// Serialises the values that are known now.
    #[must_use]
    pub fn telemetry(state: &State) -> Option<Self> {
        Self::new("telemetry", &state.telemetry(Now::read()))
    }

    /// Wraps a body that is JSON already.
    pub(super) fn of_json(method: &'static str, json: &str) -> Self {
        let frame = text_frame(format!(r#"{{"jsonrpc":"2.0","method":"{method}","params":{json}}}"#));
        // One brace follows the body.
        let end = frame.len().saturating_sub(1);
        Self { method, frame, body: end.saturating_sub(json.len())..end }
    }

    /// Returns the kind of update: `state`, `telemetry`, `event`, `grip`, `frame`, `damage`, `fleet` or `gap`.
    #[must_use]
    pub fn method(&self) -> &'static str {
        self.method
    }

    #[must_use]
    pub fn frame(&self) -> Bytes {
        self.frame.clone()
    }

    /// Returns the update's JSON without its envelope.
    #[must_use]
    pub fn body(&self) -> &str {
        self.frame.get(self.body.clone()).and_then(|body| std::str::from_utf8(body).ok()).unwrap_or_default()
    }
}

/// Encodes a text as one WebSocket frame of a server (RFC 6455, 5.2).
#[must_use]
pub fn text_frame(text: String) -> Bytes {
    encoded(Frame::message(text, OpCode::Data(Data::Text), true))
}

/// Encodes a WebSocket frame.
#[must_use]
pub fn encoded(frame: Frame) -> Bytes {
    let mut bytes = Vec::with_capacity(frame.len());
    // Writing into memory does not fail.
    let _ = frame.format(&mut bytes);
    bytes.into()
}

/// The newest notifications of one kind, by sequence number. The first caller to need one makes it for the others.
#[derive(Debug)]
pub(super) struct Recent(Vec<Mutex<Option<(u64, Notification)>>>);

impl Recent {
    /// Keeps at most `count` notifications.
    pub(super) fn new(count: usize) -> Self {
        Self((0..count).map(|_| Mutex::default()).collect())
    }

    /// Returns the notification with this sequence number, and makes it if it is missing.
    pub(super) fn get(&self, seq: u64, make: impl FnOnce() -> Option<Notification>) -> Option<Notification> {
        let slot = self.0.get(usize::try_from(seq % self.0.len() as u64).ok()?)?;
        // A panic under the lock leaves nothing half done.
        let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
        match &*slot {
            Some((kept, notification)) if *kept == seq => Some(notification.clone()),
            // A slow subscriber does not replace what faster ones share.
            Some((kept, _)) if *kept > seq => make(),
            _ => {
                let new = make()?;
                *slot = Some((seq, new.clone()));
                Some(new)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notification_wraps_its_body() {
        let notification = Notification::new("state", &serde_json::json!({"seq": 7})).unwrap();
        let text = br#"{"jsonrpc":"2.0","method":"state","params":{"seq":7}}"#;
        assert_eq!(notification.frame(), [&[0x81, text.len() as u8][..], text].concat());
        assert_eq!(notification.body(), r#"{"seq":7}"#);
    }

    #[test]
    fn notification_is_made_once_and_never_replaces_a_newer_one() {
        let recent = Recent::new(2);
        let count = std::cell::Cell::new(0);
        let ask = |seq: u64| {
            let make = || {
                count.set(count.get() + 1);
                Notification::new("event", &seq)
            };
            recent.get(seq, make).unwrap().body().to_owned()
        };
        assert_eq!(["1", "2", "1", "2"], [ask(1), ask(2), ask(1), ask(2)].each_ref().map(String::as_str));
        assert_eq!(count.get(), 2);
        assert_eq!((ask(3), ask(1), ask(3)), ("3".to_owned(), "1".to_owned(), "3".to_owned()));
        assert_eq!(count.get(), 4);
    }
}
