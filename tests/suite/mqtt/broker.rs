//! A broker in the test's process, which keeps what it gets, and can misbehave. Real brokers are in `tests/mqtt_clients`.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};

use bytes::Bytes;
use futures_util::{SinkExt as _, StreamExt as _};
use rumqttc::v5::mqttbytes::v5::{
    Codec, ConnAck, ConnectReturnCode, LastWill, Login, Packet, PingResp, PubAck, PubAckReason, Publish,
    PublishProperties, SubAck, SubscribeReasonCode,
};
use rumqttc::v5::mqttbytes::{self, QoS, matches};
use serde_json::Value;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_rustls::TlsAcceptor;
use tokio_util::codec::Framed;
use tokio_util::sync::CancellationToken;

use crate::harness::eventually;

/// Behaviour of a broker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mood {
    Normal,
    /// Accepts connections, and never answers.
    Silent,
    /// Acknowledges no message.
    Unacknowledging,
    /// Refuses all messages that are published.
    Refusing,
    /// Refuses all connections.
    Closed,
}

/// A message that the broker got.
#[derive(Debug, Clone)]
pub struct Got {
    pub topic: String,
    pub text: String,
    pub is_retained: bool,
    pub qos: QoS,
    pub properties: PublishProperties,
}

impl Got {
    fn of(message: &Publish) -> Self {
        Self {
            topic: String::from_utf8(message.topic.to_vec()).unwrap(),
            text: String::from_utf8(message.payload.to_vec()).unwrap(),
            is_retained: message.retain,
            qos: message.qos,
            properties: message.properties.clone().unwrap_or_default(),
        }
    }

    pub fn json(&self) -> Value {
        serde_json::from_str(&self.text).unwrap_or_else(|error| panic!("{error}: {self:?}"))
    }

    pub fn property(&self, name: &str) -> Option<&str> {
        self.properties.user_properties.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }
}

#[derive(Debug)]
struct State {
    mood: Mood,
    got: Vec<Got>,
    logins: Vec<Option<Login>>,
    /// Messages that subscribers get when they subscribe.
    retained: BTreeMap<String, String>,
    subscribers: Vec<(String, mpsc::Sender<Packet>)>,
    /// Ends the present connections.
    connections: CancellationToken,
    connects: usize,
}

/// A broker that runs until it is dropped.
#[derive(Debug)]
pub struct Broker {
    pub address: SocketAddr,
    state: Arc<Mutex<State>>,
    accepting: JoinHandle<()>,
}

impl Drop for Broker {
    fn drop(&mut self) {
        self.accepting.abort();
        self.state.lock().unwrap().connections.cancel();
    }
}

/// A request from a client.
#[derive(Debug, Default)]
pub struct Request<'a> {
    pub topic: &'a str,
    pub payload: &'a str,
    pub correlation: Option<&'a str>,
    pub properties: &'a [(&'a str, &'a str)],
    pub is_retained: bool,
}

/// Topic of all answers.
pub const ANSWERS: &str = "answers/test";

impl Broker {
    pub async fn start() -> Self {
        Self::with_tls(None).await
    }

    pub async fn with_tls(tls: Option<TlsAcceptor>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let state = Arc::new(Mutex::new(State {
            mood: Mood::Normal,
            got: Vec::new(),
            logins: Vec::new(),
            retained: BTreeMap::new(),
            subscribers: Vec::new(),
            connections: CancellationToken::new(),
            connects: 0,
        }));
        let shared = state.clone();
        let accepting = tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                let state = shared.clone();
                let ending = state.lock().unwrap().connections.clone();
                let tls = tls.clone();
                tokio::spawn(async move {
                    ending
                        .run_until_cancelled(async move {
                            match tls {
                                Some(tls) => {
                                    if let Ok(stream) = tls.accept(stream).await {
                                        serve(stream, state).await;
                                    }
                                }
                                None => serve(stream, state).await,
                            }
                        })
                        .await;
                });
            }
        });
        Self { address, state, accepting }
    }

    pub fn set(&self, mood: Mood) {
        self.state.lock().unwrap().mood = mood;
    }

    /// Closes all connections, as a killed broker does.
    pub fn cut(&self) {
        let mut state = self.state.lock().unwrap();
        state.subscribers.clear();
        std::mem::take(&mut state.connections).cancel();
    }

    /// Number of connections so far.
    pub fn connects(&self) -> usize {
        self.state.lock().unwrap().connects
    }

    pub fn logins(&self) -> Vec<Option<Login>> {
        self.state.lock().unwrap().logins.clone()
    }

    /// Keeps a message for new subscribers.
    pub fn retain(&self, topic: &str, payload: &str) {
        self.state.lock().unwrap().retained.insert(topic.to_owned(), payload.to_owned());
    }

    /// Returns all messages to topics that match a filter.
    pub fn all(&self, filter: &str) -> Vec<Got> {
        let state = self.state.lock().unwrap();
        state.got.iter().filter(|got| matches(&got.topic, filter)).cloned().collect()
    }

    /// Waits for a message to a topic that matches a filter and a condition.
    pub async fn until(&self, filter: &str, is_wanted: impl Fn(&Got) -> bool) -> Got {
        eventually(filter, async || self.all(filter).into_iter().find(|got| is_wanted(got))).await
    }

    /// Waits until somebody has subscribed to a topic.
    pub async fn until_subscribed(&self, topic: &str) {
        eventually(&format!("a subscription of {topic}"), async || (self.subscribers(topic) > 0).then_some(())).await;
    }

    fn subscribers(&self, topic: &str) -> usize {
        let state = self.state.lock().unwrap();
        state.subscribers.iter().filter(|(filter, _)| matches(topic, filter)).count()
    }

    /// Publishes a request.
    pub fn send(&self, request: &Request<'_>) {
        let Request { topic, payload, correlation, properties, is_retained } = *request;
        let properties = PublishProperties {
            response_topic: Some(ANSWERS.to_owned()),
            correlation_data: correlation.map(|data| Bytes::copy_from_slice(data.as_bytes())),
            user_properties: properties.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect(),
            ..PublishProperties::default()
        };
        let mut message = Publish::new(topic, QoS::AtLeastOnce, payload.to_owned(), Some(properties));
        message.pkid = 1;
        message.retain = is_retained;
        let state = self.state.lock().unwrap();
        for (_, subscriber) in state.subscribers.iter().filter(|(filter, _)| matches(topic, filter)) {
            let _ = subscriber.try_send(Packet::Publish(message.clone()));
        }
    }

    /// Forgets the messages to topics that match a filter, except those with correlation data.
    pub fn forget(&self, filter: &str) {
        let mut state = self.state.lock().unwrap();
        state.got.retain(|got| !matches(&got.topic, filter) || got.properties.correlation_data.is_some());
    }

    /// Publishes a request many times, with QoS 0.
    pub fn flood(&self, topic: &str, payload: &str, count: usize) {
        let properties = PublishProperties { response_topic: Some(ANSWERS.to_owned()), ..PublishProperties::default() };
        let message = Publish::new(topic, QoS::AtMostOnce, payload.to_owned(), Some(properties));
        let state = self.state.lock().unwrap();
        for (_, subscriber) in state.subscribers.iter().filter(|(filter, _)| matches(topic, filter)) {
            for _ in 0..count {
                let _ = subscriber.try_send(Packet::Publish(message.clone()));
            }
        }
    }

    /// Publishes a request, and returns the answer to it.
    pub async fn ask(&self, topic: &str, payload: &str) -> Got {
        let correlation = uuid::Uuid::now_v7().to_string();
        self.send(&Request { topic, payload, correlation: Some(&correlation), ..Request::default() });
        self.answer(&correlation).await
    }

    /// Waits for the answer with this correlation data.
    pub async fn answer(&self, correlation: &str) -> Got {
        let is_it = |got: &Got| got.properties.correlation_data.as_deref() == Some(correlation.as_bytes());
        self.until(ANSWERS, is_it).await
    }
}

async fn serve(stream: impl AsyncRead + AsyncWrite + Unpin, state: Arc<Mutex<State>>) {
    let mut stream = Framed::new(stream, Codec { max_incoming_size: None, max_outgoing_size: None });
    let (sender, mut queue) = mpsc::channel(10_000);
    let mut will: Option<LastWill> = None;
    loop {
        let mood = state.lock().unwrap().mood;
        let packet = tokio::select! {
            packet = stream.next() => packet,
            Some(packet) = queue.recv() => {
                stream.send(packet).await.unwrap();
                continue;
            }
        };
        let answer = match packet {
            _ if mood == Mood::Silent => continue,
            Some(Ok(Packet::Connect(_, last_will, login))) => {
                will = last_will;
                state.lock().unwrap().logins.push(login);
                Some(connected(mood, &state))
            }
            Some(Ok(Packet::Publish(message))) => received(&message, mood, &state),
            Some(Ok(Packet::Subscribe(subscribe))) => {
                for filter in &subscribe.filters {
                    subscribed(&filter.path, &sender, &state);
                }
                let granted = subscribe.filters.iter().map(|_| SubscribeReasonCode::Success(QoS::AtLeastOnce));
                Some(Packet::SubAck(SubAck { pkid: subscribe.pkid, return_codes: granted.collect(), properties: None }))
            }
            Some(Ok(Packet::PingReq(_))) => Some(Packet::PingResp(PingResp)),
            // The codec takes a DISCONNECT without a reason for an error.
            Some(Ok(Packet::Disconnect(_)) | Err(mqttbytes::Error::PayloadRequired)) => return,
            Some(Ok(_)) => None,
            Some(Err(_)) | None => break,
        };
        if let Some(answer) = answer
            && stream.send(answer).await.is_err()
        {
            break;
        }
    }
    let Some(will) = will else { return };
    let message = Publish { topic: will.topic, payload: will.message, retain: will.retain, ..Publish::default() };
    state.lock().unwrap().got.push(Got::of(&message));
}

fn connected(mood: Mood, state: &Mutex<State>) -> Packet {
    state.lock().unwrap().connects += 1;
    let code = if mood == Mood::Closed { ConnectReturnCode::NotAuthorized } else { ConnectReturnCode::Success };
    Packet::ConnAck(ConnAck { session_present: false, code, properties: None })
}

fn received(message: &Publish, mood: Mood, state: &Mutex<State>) -> Option<Packet> {
    state.lock().unwrap().got.push(Got::of(message));
    let reason = if mood == Mood::Refusing { PubAckReason::NotAuthorized } else { PubAckReason::Success };
    let is_answered = message.qos == QoS::AtLeastOnce && mood != Mood::Unacknowledging;
    is_answered.then(|| Packet::PubAck(PubAck { reason, ..PubAck::new(message.pkid, None) }))
}

fn subscribed(filter: &str, sender: &mpsc::Sender<Packet>, state: &Mutex<State>) {
    let mut state = state.lock().unwrap();
    state.subscribers.push((filter.to_owned(), sender.clone()));
    for (topic, payload) in state.retained.iter().filter(|(topic, _)| matches(topic, filter)) {
        let properties = PublishProperties { response_topic: Some(ANSWERS.to_owned()), ..PublishProperties::default() };
        let mut message = Publish::new(topic, QoS::AtLeastOnce, payload.clone(), Some(properties));
        message.retain = true;
        message.pkid = 2;
        let _ = sender.try_send(Packet::Publish(message));
    }
}
