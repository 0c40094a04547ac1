//! A WebSocket client.

use std::collections::{HashMap, VecDeque};
use std::sync::LazyLock;
use std::time::Duration;

use futures_util::{SinkExt as _, StreamExt as _};
use jsonschema::{Draft, Validator};
use serde_json::{Value, json};
use tokio::net::{TcpSocket, TcpStream};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::handshake::client::Request;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

use super::{DEADLINE, Gateway};

/// Receive buffer of a client that is slow to read.
const SMALL_BUFFER: u32 = 4096;

/// A client that checks every message against the AsyncAPI document, and queues notifications that arrive while it
/// waits for an answer.
#[derive(Debug)]
pub struct Socket {
    stream: WebSocketStream<TcpStream>,
    last_id: u64,
    /// Methods of the requests, by id.
    asked: HashMap<u64, String>,
    queued: VecDeque<Value>,
}

/// Message schemas of the AsyncAPI document. They apply to all messages read, and to all messages sent through
/// [`Socket::call`].
#[derive(Debug)]
struct Description(HashMap<String, Validator>);

/// Parsed once, since this takes long enough for an open socket to miss pings.
static DESCRIPTION: LazyLock<Description> = LazyLock::new(Description::read);

impl Description {
    fn read() -> Self {
        let document = wsg_gateway::interfaces::http::asyncapi_document();
        let components = &document["components"];
        let validator = |name: &String| {
            let payload = json!({"$ref": format!("#/components/messages/{name}/payload")});
            let schema = json!({"components": components, "allOf": [payload]});
            let built = jsonschema::options().with_draft(Draft::Draft7).build(&schema);
            (name.clone(), built.unwrap_or_else(|error| panic!("{name}: {error}")))
        };
        Self(components["messages"].as_object().unwrap().keys().map(validator).collect())
    }

    fn allows(&self, name: &str, message: &Value) -> bool {
        self.0.get(name).is_some_and(|validator| validator.is_valid(message))
    }

    #[track_caller]
    fn check(&self, name: &str, message: &Value) {
        let validator = self.0.get(name).unwrap_or_else(|| panic!("{name} has no schema: {message}"));
        let errors: Vec<_> = validator.iter_errors(message).map(|error| error.to_string()).collect();
        assert!(errors.is_empty(), "{name} does not match its schema: {errors:?}: {message}");
    }
}

/// Returns a WebSocket upgrade request with the right subprotocol.
pub fn request(gateway: &Gateway) -> Request {
    let url = gateway.url("/api/v1/ws").replacen("http", "ws", 1);
    let mut request = url.into_client_request().unwrap();
    request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("wsg.v1"));
    request
}

impl Socket {
    pub async fn open(gateway: &Gateway) -> Self {
        Self::with(request(gateway)).await.unwrap()
    }

    /// Opens a WebSocket with this request.
    pub async fn with(request: Request) -> Result<Self, Error> {
        LazyLock::force(&DESCRIPTION);
        let address = request.uri().authority().unwrap().as_str().parse().unwrap();
        let socket = TcpSocket::new_v4().unwrap();
        // Small, so that a test of a stalled reader fills the buffer quickly.
        socket.set_recv_buffer_size(SMALL_BUFFER).unwrap();
        let connected = socket.connect(address).await.unwrap();
        let (stream, _) = client_async(request, connected).await?;
        let (asked, queued) = (HashMap::new(), VecDeque::new());
        Ok(Self { stream, last_id: 0, asked, queued })
    }

    pub async fn send(&mut self, text: impl Into<String>) {
        self.stream.send(Message::text(text.into())).await.unwrap();
    }

    pub async fn send_binary(&mut self, bytes: Vec<u8>) {
        self.stream.send(Message::binary(bytes)).await.unwrap();
    }

    /// Sends a request without waiting for its answer, and returns its id.
    pub async fn begin(&mut self, method: &str, params: Value) -> u64 {
        self.last_id += 1;
        let request = json!({"jsonrpc": "2.0", "id": self.last_id, "method": method, "params": params});
        self.send(request.to_string()).await;
        self.asked.insert(self.last_id, method.to_owned());
        self.last_id
    }

    /// Returns the next message, queued ones first, or `None` at the end.
    pub async fn next(&mut self) -> Option<Value> {
        if let Some(queued) = self.queued.pop_front() {
            return Some(queued);
        }
        self.read().await
    }

    /// Returns the next message off the wire.
    pub async fn read(&mut self) -> Option<Value> {
        let text = async {
            loop {
                match self.stream.next().await {
                    Some(Ok(Message::Text(text))) => return Some(text),
                    end @ (Some(Ok(Message::Close(_)) | Err(_)) | None) => {
                        eprintln!("the socket closed: {end:?}");
                        return None;
                    }
                    // Pings arrive all the time.
                    Some(Ok(_)) => {}
                }
            }
        };
        let text = timeout(DEADLINE, text).await.expect("a message arrives")?;
        let message: Value = serde_json::from_str(&text).unwrap();
        for message in message.as_array().map_or(std::slice::from_ref(&message), Vec::as_slice) {
            let asked = message["id"].as_u64().and_then(|id| self.asked.get(&id));
            let name = match (message["method"].as_str(), asked) {
                (Some(method), _) => format!("{method}.notification"),
                (None, Some(method)) if message.get("result").is_some() => format!("{method}.answer"),
                (None, _) if message.get("result").is_some() => continue,
                (None, _) => "error".to_owned(),
            };
            DESCRIPTION.check(&name, message);
        }
        Some(message)
    }

    /// Waits for the answer to this request.
    pub async fn answer(&mut self, id: u64) -> Value {
        // This answer can have arrived before that to an earlier request.
        if let Some(index) = self.queued.iter().position(|message| message["id"] == id) {
            return self.queued.remove(index).unwrap();
        }
        loop {
            let read = self.read().await.expect("an answer arrives");
            if read["id"] == id {
                assert_eq!(read["jsonrpc"], "2.0");
                return read;
            }
            self.queued.push_back(read);
        }
    }

    /// Sends a request, and returns its result.
    pub async fn call(&mut self, method: &str, params: Value) -> Value {
        let request = json!({"jsonrpc": "2.0", "id": 1, "method": method, "params": params});
        DESCRIPTION.check(method, &request);
        let id = self.begin(method, params).await;
        let answer = self.answer(id).await;
        assert!(answer.get("error").is_none(), "{method}: {answer}");
        answer["result"].clone()
    }

    /// Sends a request that must be refused, and returns the error.
    pub async fn refused(&mut self, method: &str, params: Value) -> Value {
        let id = self.begin(method, params).await;
        let answer = self.answer(id).await;
        assert!(answer.get("result").is_none(), "{method}: {answer}");
        answer["error"].clone()
    }

    /// Returns the next notification of this method that `wanted` accepts, and drops others.
    pub async fn notification(&mut self, method: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        loop {
            let notification = self.next().await.unwrap_or_else(|| panic!("no {method} arrives before the end"));
            if notification["method"] == method && wanted(&notification["params"]) {
                return notification["params"].clone();
            }
        }
    }

    /// Whether the AsyncAPI document allows this message.
    pub fn is_described(name: &str, message: &Value) -> bool {
        DESCRIPTION.allows(name, message)
    }

    /// Drops queued messages.
    pub fn drop_queued(&mut self) {
        self.queued.clear();
    }

    /// Whether no message arrives for this time.
    pub async fn is_silent_for(&mut self, time: Duration) -> bool {
        self.queued.is_empty() && timeout(time, self.read()).await.is_err()
    }
}
