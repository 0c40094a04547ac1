//! FAST STOP via a put: any payload stops. A FAST STOP shares no queue with other traffic. A delete is not a FAST STOP:
//! `delete wsg/**` clears the storages of a network, and matches these keys too.

use std::sync::{Arc, Mutex, PoisonError};

use serde_json::{Map, Value};
use tokio::runtime::Handle;
use zenoh::sample::{Sample, SampleKind};

use super::client::client;
use crate::connections::metrics::InterfaceMetrics;
use crate::fleet::keys::{FAST_STOP_OF_ALL, ZenohKeys};
use crate::gripper::Grippers;
use crate::model::{Client, Code, Reason, ShownName, without_byte_order_mark};

/// Last part of the keys, and the route in the metrics.
const FAST_STOP: &str = "fast-stop";

/// Maximum number of concurrent FAST STOPs, each of which ends within 250 ms. Beyond it only the newest is kept, which
/// starts when one has ended: the grippers are already being stopped.
const MAX_UNDER_WAY: usize = 64;

/// Bytes of a payload that are searched for a reason.
const MAX_REASON_BYTES: usize = 1024;

/// The FAST STOPs of one gateway.
#[derive(Debug, Clone)]
pub struct FastStops {
    fleet: Grippers,
    clients: Handle,
    metrics: InterfaceMetrics,
    under_way: Arc<Mutex<UnderWay>>,
}

#[derive(Debug, Default)]
struct UnderWay {
    count: usize,
    next: Option<(Client, Reason)>,
}

impl FastStops {
    /// Returns the FAST STOPs of these grippers, on the interfaces' runtime.
    pub fn new(fleet: Grippers, clients: Handle, metrics: InterfaceMetrics) -> Self {
        Self { fleet, clients, metrics, under_way: Arc::default() }
    }

    /// Subscribes to the keys of this gateway and of all gateways.
    pub async fn declare(self, session: &zenoh::Session, keys: &ZenohKeys) -> zenoh::Result<()> {
        for key in [keys.own(FAST_STOP), FAST_STOP_OF_ALL.to_owned()] {
            let stops = self.clone();
            session.declare_subscriber(key).callback(move |sample| stops.receive(&sample)).background().await?;
        }
        Ok(())
    }

    fn receive(&self, sample: &Sample) {
        match sample.kind() {
            SampleKind::Put => {
                let (client, reason) = asked(&sample.payload().to_bytes());
                self.begin(client, reason);
            }
            SampleKind::Delete => {
                self.metrics.answered(Some(FAST_STOP), "DELETE", Code::MethodNotAllowed.http_status());
                let key = sample.key_expr().as_str();
                tracing::warn!(key, "Zenoh delete ignored: only a put is a FAST STOP");
            }
        }
    }

    /// Stops all grippers without waiting.
    fn begin(&self, client: Client, reason: Reason) {
        {
            let mut under_way = self.under_way.lock().unwrap_or_else(PoisonError::into_inner);
            if under_way.count >= MAX_UNDER_WAY {
                under_way.next = Some((client, reason));
                return;
            }
            under_way.count += 1;
        }
        let stops = self.clone();
        self.clients.spawn(async move {
            let mut next = Some((client, reason));
            while let Some((client, reason)) = next {
                let (id, _) = stops.fleet.fast_stop(&client, &reason).await;
                tracing::info!(fast_stop = %id, reason = reason.as_str(), "FAST STOP via Zenoh");
                next = stops.ended();
            }
        });
    }

    /// Returns the FAST STOP that the calling task runs next; `None` ends the task.
    fn ended(&self) -> Option<(Client, Reason)> {
        let mut under_way = self.under_way.lock().unwrap_or_else(PoisonError::into_inner);
        let next = under_way.next.take();
        under_way.count -= usize::from(next.is_none());
        next
    }
}

/// Returns client and reason of a payload: the fields `client` and `reason` of an object, or plain text as the reason.
fn asked(payload: &[u8]) -> (Client, Reason) {
    let payload = payload.get(..MAX_REASON_BYTES).unwrap_or(payload);
    let text = String::from_utf8_lossy(without_byte_order_mark(payload));
    let (name, reason) = match serde_json::from_str(&text) {
        Ok(Value::Object(body)) => (text_field(&body, "client"), text_field(&body, "reason")),
        Ok(Value::String(reason)) => (String::new(), reason),
        _ => (String::new(), text.into_owned()),
    };
    let name = ShownName::new(&name).ok().filter(|name| !name.as_str().is_empty());
    (client(name.as_ref()), Reason::truncated(&reason))
}

fn text_field(body: &Map<String, Value>, name: &str) -> String {
    body.get(name).and_then(Value::as_str).unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use prometheus::Registry;

    use super::*;
    use crate::gripper::fake::{self, FakeScript, Seen};

    #[test]
    fn any_payload_gives_a_reason() {
        for (payload, expected) in [
            (&br#"{"reason": "light curtain"}"#[..], "light curtain"),
            (br#""light curtain""#, "light curtain"),
            (b"light curtain", "light curtain"),
            (b"\xEF\xBB\xBF{\"reason\": \"light curtain\"}", "light curtain"),
            (b"", ""),
            (b"{\"reason\": 7}", ""),
            (b"\xFF\x00", "\u{FFFD}"),
            (&[b'x'; 5000], &"x".repeat(64)),
        ] {
            let (client, reason) = asked(payload);
            assert_eq!((reason.as_str(), &*client.subject), (expected, "zenoh:unknown"));
        }
        let (client, reason) = asked(br#"{"reason": "light curtain", "client": "http:127.0.0.1"}"#);
        assert_eq!((reason.as_str(), &*client.subject), ("light curtain", "zenoh:http:127.0.0.1"));
    }

    #[tokio::test]
    async fn newest_fast_stop_beyond_the_limit_runs() {
        let (handle, mut seen) = fake::gripper("left", FakeScript::default());
        let metrics = InterfaceMetrics::register(&Registry::new(), "zenoh").unwrap();
        let stops = FastStops::new(Grippers::new([handle]), Handle::current(), metrics);
        for index in 0..=2 * MAX_UNDER_WAY {
            stops.begin(asked(b"").0, Reason::truncated(&index.to_string()));
        }
        let newest = (2 * MAX_UNDER_WAY).to_string();
        let mut count = 0;
        while let Some(request) = seen.recv().await {
            let Seen::FastStop(reason) = request else { continue };
            count += 1;
            if reason.as_str() == newest {
                break;
            }
        }
        assert_eq!(count, MAX_UNDER_WAY + 1);
    }
}
