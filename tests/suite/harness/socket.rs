//! A client's WebSocket.

use std::collections::{HashMap, VecDeque};
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

/// What a client that is slow to read has of its own.
const SMALL_BUFFER: u32 = 4096;

/// It. What it is told while an answer is awaited is kept.
#[derive(Debug)]
pub struct Socket {
    stream: WebSocketStream<TcpStream>,
    last_id: u64,
    /// The methods of the requests, by their ids.
    asked: HashMap<u64, String>,
    told: VecDeque<Value>,
    description: Description,
}

/// What the AsyncAPI document says of messages: all that is read is checked against it, and all that is sent and is not
/// refused.
#[derive(Debug)]
struct Description(HashMap<String, Validator>);

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
        let validator = self.0.get(name).unwrap_or_else(|| panic!("{name} is not described: {message}"));
        let errors: Vec<_> = validator.iter_errors(message).map(|error| error.to_string()).collect();
        assert!(errors.is_empty(), "{name} is not as described: {errors:?}: {message}");
    }
}

/// A request for a WebSocket, with the right subprotocol.
pub fn request(gateway: &Gateway) -> Request {
    let url = gateway.url("/api/v1/ws").replacen("http", "ws", 1);
    let mut request = url.into_client_request().unwrap();
    request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("wsg.v1"));
    request
}

impl Socket {
    /// Opens one.
    pub async fn open(gateway: &Gateway) -> Self {
        Self::with(request(gateway)).await.unwrap()
    }

    /// Opens one by this request.
    pub async fn with(request: Request) -> Result<Self, Error> {
        // It takes a while, in which no ping would be answered.
        let description = Description::read();
        let address = request.uri().authority().unwrap().as_str().parse().unwrap();
        let socket = TcpSocket::new_v4().unwrap();
        // Small, so that a test that doesn't read needn't wait for megabytes.
        socket.set_recv_buffer_size(SMALL_BUFFER).unwrap();
        let connected = socket.connect(address).await.unwrap();
        let (stream, _) = client_async(request, connected).await?;
        let (asked, told) = (HashMap::new(), VecDeque::new());
        Ok(Self { stream, last_id: 0, asked, told, description })
    }

    /// Sends a text.
    pub async fn send(&mut self, text: impl Into<String>) {
        self.stream.send(Message::text(text.into())).await.unwrap();
    }

    /// Sends a request, and doesn't wait for its answer. Returns its id.
    pub async fn begin(&mut self, method: &str, params: Value) -> u64 {
        self.last_id += 1;
        let request = json!({"jsonrpc": "2.0", "id": self.last_id, "method": method, "params": params});
        self.send(request.to_string()).await;
        self.asked.insert(self.last_id, method.to_owned());
        self.last_id
    }

    /// The next message, whatever it is; none at the end.
    pub async fn next(&mut self) -> Option<Value> {
        if let Some(told) = self.told.pop_front() {
            return Some(told);
        }
        self.read().await
    }

    /// The next message off the wire.
    pub async fn read(&mut self) -> Option<Value> {
        let text = async {
            loop {
                match self.stream.next().await {
                    Some(Ok(Message::Text(text))) => return Some(text),
                    end @ (Some(Ok(Message::Close(_)) | Err(_)) | None) => {
                        eprintln!("the socket has ended: {end:?}");
                        return None;
                    }
                    // Pings come all the time.
                    Some(Ok(_)) => {}
                }
            }
        };
        let text = timeout(DEADLINE, text).await.expect("something comes")?;
        let message: Value = serde_json::from_str(&text).unwrap();
        for message in message.as_array().map_or(std::slice::from_ref(&message), Vec::as_slice) {
            let asked = message["id"].as_u64().and_then(|id| self.asked.get(&id));
            let name = match (message["method"].as_str(), asked) {
                (Some(method), _) => format!("{method}.notification"),
                (None, Some(method)) if message.get("result").is_some() => format!("{method}.answer"),
                (None, _) if message.get("result").is_some() => continue,
                (None, _) => "error".to_owned(),
            };
            self.description.check(&name, message);
        }
        Some(message)
    }

    /// The answer to this request.
    pub async fn answer(&mut self, id: u64) -> Value {
        loop {
            let read = self.read().await.expect("an answer comes");
            if read["id"] == id {
                assert_eq!(read["jsonrpc"], "2.0");
                return read;
            }
            self.told.push_back(read);
        }
    }

    /// What a request was answered.
    pub async fn call(&mut self, method: &str, params: Value) -> Value {
        let request = json!({"jsonrpc": "2.0", "id": 1, "method": method, "params": params});
        self.description.check(method, &request);
        let id = self.begin(method, params).await;
        let answer = self.answer(id).await;
        assert!(answer.get("error").is_none(), "{method}: {answer}");
        answer["result"].clone()
    }

    /// What a request was refused with.
    pub async fn refused(&mut self, method: &str, params: Value) -> Value {
        let id = self.begin(method, params).await;
        let answer = self.answer(id).await;
        assert!(answer.get("result").is_none(), "{method}: {answer}");
        answer["error"].clone()
    }

    /// The next notification of this method that is as wanted. Others are left out.
    pub async fn told(&mut self, method: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        loop {
            let told = self.next().await.unwrap_or_else(|| panic!("no {method} comes before the end"));
            if told["method"] == method && wanted(&told["params"]) {
                return told["params"].clone();
            }
        }
    }

    /// Whether the AsyncAPI document allows this message.
    pub fn is_described(&self, name: &str, message: &Value) -> bool {
        self.description.allows(name, message)
    }

    /// Forgets what it was told and has not looked at.
    pub fn forget(&mut self) {
        self.told.clear();
    }

    /// Whether nothing comes for so long.
    pub async fn is_silent_for(&mut self, time: Duration) -> bool {
        self.told.is_empty() && timeout(time, self.read()).await.is_err()
    }
}
