//! A client on a Zenoh network.

use std::sync::{Arc, Mutex};

use serde_json::{Value, json};
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::sample::{Sample, SampleKind};

use super::{DEADLINE, Gateway, eventually};

#[derive(Debug)]
pub struct ZenohClient {
    pub session: zenoh::Session,
}

/// Received samples in order, as key and body.
#[derive(Debug, Clone, Default)]
pub struct Samples(Arc<Mutex<Vec<(String, Value)>>>);

impl Samples {
    fn take(&self, sample: &Sample) {
        let text = sample.payload().try_to_string().unwrap();
        let body = match sample.kind() {
            SampleKind::Put => serde_json::from_str(&text).unwrap_or(Value::String(text.into_owned())),
            SampleKind::Delete => Value::Null,
        };
        self.0.lock().unwrap().push((sample.key_expr().to_string(), body));
    }

    pub fn all(&self) -> Vec<(String, Value)> {
        self.0.lock().unwrap().clone()
    }

    /// Bodies received under a key so far.
    pub fn of(&self, key: &str) -> Vec<Value> {
        self.all().into_iter().filter(|(of, _)| of == key).map(|(_, body)| body).collect()
    }

    /// Waits for a body under this key that `wanted` accepts.
    pub async fn until(&self, key: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        eventually(key, async || self.of(key).into_iter().find(&wanted)).await
    }
}

/// Zenoh configuration without scouting or automatic connections.
pub fn config(mode: &str, listen: &[&str], connect: &[&str]) -> zenoh::Config {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", json!(mode)),
        ("listen/endpoints", json!(listen)),
        ("connect/endpoints", json!(connect)),
        // By default a client tries only once, which can be too early on a busy machine.
        ("connect/timeout_ms", json!(DEADLINE.as_millis() as u64 / 2)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/autoconnect", json!({"router": [], "peer": [], "client": []})),
    ] {
        config.insert_json5(key, &value.to_string()).unwrap();
    }
    config
}

impl ZenohClient {
    /// Connects to this gateway.
    pub async fn of(gateway: &Gateway) -> Self {
        Self::at(&gateway.word_after("Zenoh: ").await).await
    }

    /// Connects to this endpoint.
    pub async fn at(endpoint: &str) -> Self {
        Self::with(config("client", &[], &[endpoint])).await
    }

    /// Opens a session with this configuration.
    pub async fn with(config: zenoh::Config) -> Self {
        let opened = tokio::time::timeout(DEADLINE, zenoh::open(config)).await;
        Self { session: opened.expect("a router or a gateway answers").unwrap() }
    }

    /// Returns all replies, each with its key; problems are errors.
    pub async fn all(&self, selector: &str, payload: impl Into<ZBytes>) -> Vec<(String, Result<Value, Value>)> {
        let json = |payload: &ZBytes| {
            let text = payload.try_to_string().unwrap();
            serde_json::from_str(&text).unwrap_or(Value::String(text.into_owned()))
        };
        let replies = self.session.get(selector).payload(payload).timeout(DEADLINE).await.unwrap();
        let mut all = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            all.push(match reply.result() {
                Ok(sample) => (sample.key_expr().to_string(), Ok(json(sample.payload()))),
                Err(error) => (String::new(), Err(json(error.payload()))),
            });
        }
        all
    }

    /// Returns the only reply to a query.
    pub async fn ask(&self, selector: &str, payload: &Value) -> Result<Value, Value> {
        let mut all = self.all(selector, payload.to_string()).await;
        assert_eq!(all.len(), 1, "{selector}: {all:?}");
        all.remove(0).1
    }

    /// Sends a command to gripper `g` of the gateway.
    pub async fn command(&self, name: &str, payload: &Value) -> Result<Value, Value> {
        self.ask(&format!("wsg/v1/gateway/g/command/{name}"), payload).await
    }

    pub async fn put(&self, key: &str, payload: impl Into<ZBytes>) {
        self.session.put(key, payload).await.unwrap();
    }

    /// Collects publications under this key expression from now on.
    pub async fn subscribe(&self, key: &str) -> Samples {
        let samples = Samples::default();
        let taking = samples.clone();
        let subscriber = self.session.declare_subscriber(key).callback(move |sample| taking.take(&sample));
        subscriber.background().await.unwrap();
        samples
    }

    /// Collects liveliness tokens that appear and disappear, starting with existing ones.
    pub async fn tokens(&self, key: &str) -> Samples {
        let samples = Samples::default();
        let taking = samples.clone();
        let liveliness = self.session.liveliness();
        let subscriber = liveliness.declare_subscriber(key).history(true).callback(move |token| taking.take(&token));
        subscriber.background().await.unwrap();
        samples
    }

    /// Declares a liveliness token at `key`, and waits until `other` sees it.
    pub async fn live(&self, other: &Self, key: &str) -> LivelinessToken {
        let seen = other.tokens(key).await;
        let token = self.session.liveliness().declare_token(key.to_owned()).await.unwrap();
        seen.until(key, |body| *body == "").await;
        token
    }

    pub async fn close(self) {
        tokio::time::timeout(DEADLINE, self.session.close()).await.unwrap().unwrap();
    }
}
