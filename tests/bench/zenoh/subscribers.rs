//! Subscribers that count messages and measure their delay.

use std::sync::{Arc, Mutex};
use std::time::{SystemTime, UNIX_EPOCH};

use futures_util::{SinkExt, StreamExt};
use serde::Deserialize;
use serde_json::json;
use tokio::runtime::Runtime;
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use zenoh::Wait as _;

use super::{Error, HZ, config};

/// Delays of the messages since the start of a measurement, in ms.
#[derive(Default)]
pub struct Seen(Mutex<Vec<i64>>);

/// Part of a telemetry body.
#[derive(Deserialize)]
struct Telemetry {
    at: jiff::Timestamp,
}

#[derive(Deserialize)]
struct Notification {
    params: Telemetry,
}

/// Wall clock, in ms.
pub fn now_ms() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as i64)
}

impl Seen {
    fn take(&self, notification: Option<&Telemetry>) {
        if let (Some(notification), Ok(mut late)) = (notification, self.0.lock()) {
            late.push(now_ms() - notification.at.as_millisecond());
        }
    }

    /// Drops earlier delays.
    pub fn begin(&self) {
        if let Ok(mut late) = self.0.lock() {
            late.clear();
        }
    }

    /// Returns the number of messages, their mean delay and its 99th percentile, in ms. Both clocks are truncated to
    /// milliseconds, so that the mean difference is right.
    pub fn end(&self) -> (usize, f64, i64) {
        let mut late = self.0.lock().map(|late| late.clone()).unwrap_or_default();
        late.sort_unstable();
        let count = late.len().max(1);
        let p99 = late.get((count - 1) * 99 / 100).copied().unwrap_or_default();
        (late.len(), late.iter().sum::<i64>() as f64 / count as f64, p99)
    }
}

/// Starts Zenoh subscribers, each with its own connection.
pub fn zenoh(count: usize, endpoint: &str, key: &str) -> Result<(Arc<Seen>, Vec<zenoh::Session>), Error> {
    let seen = Arc::new(Seen::default());
    let mut sessions = Vec::new();
    for _ in 0..count {
        let session = loop {
            // The publisher may not listen yet.
            if let Ok(session) = zenoh::open(config("client", &[], &[endpoint])?).wait() {
                break session;
            }
        };
        let seen = seen.clone();
        let take = move |sample: zenoh::sample::Sample| {
            seen.take(serde_json::from_slice(&sample.payload().to_bytes()).ok().as_ref());
        };
        session.declare_subscriber(key.to_owned()).callback(take).background().wait()?;
        sessions.push(session);
    }
    Ok((seen, sessions))
}

/// Starts WebSocket subscribers.
pub fn websocket(count: usize, address: &str) -> Result<(Arc<Seen>, Runtime), Error> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let seen = Arc::new(Seen::default());
    for _ in 0..count {
        let (seen, address) = (seen.clone(), address.to_owned());
        runtime.spawn(async move {
            let ended = observe(&address, &seen).await;
            eprintln!("a WebSocket ended: {ended:?}");
        });
    }
    Ok((seen, runtime))
}

async fn observe(address: &str, seen: &Seen) -> Result<(), Error> {
    let mut request = format!("ws://{address}/api/v1/ws").into_client_request()?;
    request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("wsg.v1"));
    let (mut socket, _) = connect_async(request).await?;
    let params = json!({"topics": ["telemetry"], "max_hz": HZ});
    let subscribe = json!({"jsonrpc": "2.0", "id": 1, "method": "subscribe", "params": params});
    socket.send(Message::text(subscribe.to_string())).await?;
    while let Some(message) = socket.next().await {
        if let Message::Text(text) = message? {
            let notification: Option<Notification> = serde_json::from_str(&text).ok();
            seen.take(notification.as_ref().map(|notification| &notification.params));
        }
    }
    Ok(())
}
