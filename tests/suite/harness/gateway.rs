//! A gateway process and its HTTP interface.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;

use reqwest::header::{AUTHORIZATION, HeaderMap};
use reqwest::{Method, RequestBuilder, Response};
use serde_json::{Value, json};

use super::child::Signal;
use super::process::{Ended, Process};
use super::{Directory, eventually};

/// Idle time after which a connection is not used again. The gateway closes it after 10 s.
const POOL_IDLE_TIMEOUT: Duration = Duration::from_secs(5);

/// Name of the file of tokens.
const TOKENS: &str = "tokens.json";

/// Builder of a client that avoids connections which the gateway may be closing.
fn client() -> reqwest::ClientBuilder {
    reqwest::Client::builder().pool_idle_timeout(POOL_IDLE_TIMEOUT)
}

/// A gateway. Paths are relative to its gripper `g`, unless they begin with a slash.
#[derive(Debug)]
pub struct Gateway {
    process: Process,
    base: String,
    http: reqwest::Client,
    files: Option<Directory>,
}

/// An HTTP response.
#[derive(Debug, Clone)]
pub struct Answer {
    pub status: u16,
    pub location: Option<String>,
    pub body: Value,
}

impl Answer {
    async fn of(response: Response) -> Self {
        let status = response.status().as_u16();
        let location = response.headers().get("location").map(|value| value.to_str().unwrap().to_owned());
        let text = response.text().await.unwrap();
        let body = serde_json::from_str(&text).unwrap_or(Value::String(text));
        Self { status, location, body }
    }

    pub fn field(&self, name: &str) -> &Value {
        &self.body[name]
    }

    /// Returns a string field.
    #[track_caller]
    pub fn text(&self, name: &str) -> String {
        self.body[name].as_str().unwrap_or_else(|| panic!("no text {name} in {self:?}")).to_owned()
    }

    /// Asserts status 200, and returns the body.
    #[track_caller]
    pub fn ok(self) -> Value {
        assert_eq!(self.status, 200, "{}", self.body);
        self.body
    }

    /// Asserts a problem of this status and code, and returns its body.
    #[track_caller]
    pub fn problem(self, status: u16, code: &str) -> Value {
        assert_eq!((self.status, self.body["code"].as_str()), (status, Some(code)), "{}", self.body);
        self.body
    }

    /// Asserts that the command ended with this outcome.
    #[track_caller]
    pub fn outcome(self, outcome: &str) -> Value {
        let body = self.ok();
        assert_eq!((&body["phase"], &body["outcome"]), (&json!("done"), &json!(outcome)), "{body}");
        body
    }
}

impl Gateway {
    /// Serves the device at `device` as `g`.
    pub async fn of(device: SocketAddr) -> Self {
        Self::start(&["--gripper", &format!("g=tcp://{device}")]).await
    }

    /// Serves the device at `device` as `g`, and waits until it is connected.
    pub async fn connected_to(device: SocketAddr) -> Self {
        let gateway = Self::of(device).await;
        gateway.until_link("connected").await;
        gateway
    }

    /// Serves the device at `device` as `g`, connected and homed.
    pub async fn homed_at(device: SocketAddr) -> Self {
        let gateway = Self::connected_to(device).await;
        gateway.post("home", &json!({})).await.outcome("SUCCESS");
        gateway
    }

    /// Serves the device at `device` as `g`, connected, with a WSG port and these extra arguments.
    pub async fn with_port(device: SocketAddr, arguments: &[&str]) -> (Self, SocketAddr) {
        let gripper = format!("g=tcp://{device}");
        let own = ["--gripper", &gripper, "--wsg-port", "g=127.0.0.1:0"];
        let gateway = Self::start(&[&own[..], arguments].concat()).await;
        gateway.until_link("connected").await;
        let port = gateway.process.word_after("WSG port of g: tcp://").await.parse().unwrap();
        (gateway, port)
    }

    /// Starts a gateway with these arguments and this configuration file.
    pub async fn with_file(arguments: &[&str], toml: &str) -> Self {
        let files = Directory::new();
        let file = files.write("gateway.toml", toml);
        let mut gateway = Self::start(&[arguments, &["--config", &file]].concat()).await;
        gateway.files = Some(files);
        gateway
    }

    /// Starts a gateway with these arguments, a webhook whose receiver is down and a broker that is down, so that all
    /// metrics exist. Homes its gripper `g`.
    pub async fn with_webhook(arguments: &[&str]) -> Self {
        let webhook = "[[webhooks]]\nname = \"mes\"\nurl = \"http://127.0.0.1:1\"\n\
                       secret = \"whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw\"\n[mqtt]\nbroker = \"mqtt://127.0.0.1:1\"\n";
        let gateway = Self::with_file(arguments, webhook).await;
        gateway.until_link("connected").await;
        gateway.post("home", &json!({})).await.outcome("SUCCESS");
        gateway
    }

    /// Returns the word after `before` on standard output.
    pub async fn word_after(&self, before: &str) -> String {
        self.process.word_after(before).await
    }

    /// Starts a gateway with these arguments, on ports that the operating system chooses.
    pub async fn start(arguments: &[&str]) -> Self {
        let listens = arguments.iter().any(|argument| argument.starts_with("--zenoh"));
        let zenoh: &[&str] = if listens { &[] } else { &["--zenoh-listen", "tcp/127.0.0.1:0"] };
        Self::start_without_zenoh_defaults(&[zenoh, arguments].concat()).await
    }

    /// Starts a gateway of two simulated grippers, `g` and `h`, whose clients need tokens. All its requests are sent with
    /// the first of the tokens.
    pub async fn guarded(tokens: &[&str], arguments: &[&str]) -> (Self, Vec<String>) {
        let files = Directory::new();
        let path = &files.file(TOKENS);
        let mut secrets = Vec::new();
        for token in tokens {
            let create = ["token", "--tokens", path, "create"].into_iter().chain(token.split(' '));
            let created = super::run(&create.collect::<Vec<_>>()).await;
            assert!(created.status.success(), "{created:?}");
            secrets.push(created.stdout.trim().to_owned());
        }
        let own = ["--tokens", path, "--gripper", "g=sim://wsg50", "--gripper", "h=sim://wsg50"];
        let mut gateway = Self::start(&[&own[..], arguments].concat()).await;
        if let Some(first) = secrets.first() {
            gateway = gateway.with_token(first);
        }
        gateway.files = Some(files);
        (gateway, secrets)
    }

    /// Sends all requests with a token.
    pub fn with_token(self, token: &str) -> Self {
        let authorization = format!("Bearer {token}").parse().unwrap();
        let headers = HeaderMap::from_iter([(AUTHORIZATION, authorization)]);
        Self { http: client().default_headers(headers).build().unwrap(), ..self }
    }

    /// Revokes a token of a guarded gateway.
    pub async fn revoke(&self, name: &str) {
        let tokens = self.files.as_ref().expect("a guarded gateway").file(TOKENS);
        let revoked = super::run(&["token", "--tokens", &tokens, "revoke", name]).await;
        assert!(revoked.status.success(), "{revoked:?}");
    }

    /// Starts a gateway without a default Zenoh endpoint, which a configuration file sets instead.
    pub async fn start_without_zenoh_defaults(arguments: &[&str]) -> Self {
        let process = Process::start(&[&["--listen", "127.0.0.1:0"], arguments].concat());
        let base = process.word_after(" at http://").await;
        let base = format!("http://{}", base.trim_end_matches('/'));
        Self { process, base, http: client().build().unwrap(), files: None }
    }

    /// Log so far.
    pub fn log(&self) -> String {
        self.process.log()
    }

    /// Standard output so far.
    pub fn stdout(&self) -> String {
        self.process.stdout()
    }

    pub fn url(&self, path: &str) -> String {
        if path.starts_with('/') {
            format!("{}{path}", self.base)
        } else {
            format!("{}/api/v1/grippers/g/{path}", self.base).trim_end_matches('/').to_owned()
        }
    }

    /// Returns a request for the test to complete and send.
    pub fn request(&self, method: &str, path: &str) -> RequestBuilder {
        self.http.request(Method::from_bytes(method.as_bytes()).unwrap(), self.url(path))
    }

    pub async fn send(&self, request: RequestBuilder) -> Answer {
        let sent = request.send().await;
        Answer::of(sent.unwrap_or_else(|error| panic!("no answer: {error:?}"))).await
    }

    pub async fn get(&self, path: &str) -> Answer {
        self.send(self.request("GET", path)).await
    }

    pub async fn post(&self, path: &str, body: &Value) -> Answer {
        self.send(self.request("POST", path).json(body)).await
    }

    pub async fn put(&self, path: &str, body: &Value) -> Answer {
        self.send(self.request("PUT", path).json(body)).await
    }

    pub async fn delete(&self, path: &str) -> Answer {
        self.send(self.request("DELETE", path)).await
    }

    /// Starts a command without waiting for its end, and returns its id.
    pub async fn begin(&self, kind: &str, body: &Value) -> String {
        let answer = self.post(&format!("{kind}?wait_ms=0"), body).await;
        assert_eq!(answer.status, 202, "{}", answer.body);
        answer.text("id")
    }

    /// Waits for the end of a command.
    pub async fn command(&self, id: &str) -> Answer {
        self.get(&format!("commands/{id}?wait_ms=20000")).await
    }

    pub async fn state(&self) -> Value {
        self.get("state").await.ok()
    }

    /// Samples of `/metrics`, keyed by name and labels as printed.
    pub async fn figures(&self) -> BTreeMap<String, f64> {
        let text = self.get("/metrics").await.ok();
        let samples = text.as_str().unwrap().lines().filter(|line| !line.starts_with('#'));
        let figure = |line: &str| {
            let (series, figure) = line.rsplit_once(' ').unwrap_or_else(|| panic!("no sample: {line}"));
            (series.to_owned(), figure.parse().unwrap_or_else(|error| panic!("{error}: {line}")))
        };
        samples.map(figure).collect()
    }

    /// Waits until `wanted` accepts the state.
    pub async fn until(&self, what: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        eventually(what, async || Some(self.state().await).filter(&wanted)).await
    }

    /// Waits until the query finds `count` journal events. The journal can be later than the answer to a client.
    pub async fn events(&self, query: &str, count: usize) -> Vec<Value> {
        let path = format!("/api/v1/events?{query}");
        eventually(&format!("{count} events: {query}"), async || {
            let Value::Array(events) = self.get(&path).await.ok()["events"].take() else { return None };
            (events.len() >= count).then_some(events)
        })
        .await
    }

    pub async fn until_moving(&self) {
        self.until("moving", |state| state["moving"] == true).await;
    }

    /// Waits until the fingers stand still and no command runs; the gripper accepts the next motion only then.
    pub async fn until_standing(&self) -> Value {
        self.until("standing still", |state| state["moving"] == false && state["command"].is_null()).await
    }

    /// Waits until the link has this state.
    pub async fn until_link(&self, link: &str) -> Value {
        self.until(link, |state| state["link"] == link).await
    }

    /// Waits until the log contains this text.
    pub async fn until_logged(&self, what: &str) {
        self.process.until_logged(what).await;
    }

    /// Suspends the process until [`Gateway::thaw`].
    pub fn freeze(&self) {
        self.process.signal(Signal::STOP);
    }

    pub fn thaw(&self) {
        self.process.signal(Signal::CONT);
    }

    /// Sends SIGHUP, which makes the gateway read its configuration again.
    pub fn hang_up(&self) {
        self.process.signal(Signal::HUP);
    }

    /// Sends SIGTERM, and waits for the exit.
    pub async fn terminate(mut self) -> Ended {
        self.process.terminate();
        self.process.ended().await
    }

    /// Sends SIGKILL, and waits for the exit.
    pub async fn kill(mut self) {
        self.process.kill();
        self.process.ended().await;
    }
}
