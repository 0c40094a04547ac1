//! The API's operations as methods, for the doors that have no paths. Each is a request to the same router, in this
//! process: what is refused there is refused here, in the same words, and what is written down there is here.

use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::http::{HeaderMap, HeaderName, Method as Verb, Request, StatusCode};
use axum::response::Response;
use http_body_util::BodyExt;
use serde_json::value::RawValue;
use serde_json::{Map, Value, json};
use tower::ServiceExt;

use super::API;
use super::errors::{Code, Problem};
use super::extract::Presence;
use super::lease::Taken;
use crate::fleet::Urgency;
use crate::gripper::Ticket;
use crate::gripper::model::Client;

/// A method, and the operation that it is. What its path names stands among its parameters.
#[derive(Debug, Clone, Copy)]
pub struct Method {
    /// Its name.
    pub name: &'static str,
    /// The operation's method.
    pub verb: &'static Verb,
    /// The operation's path, below the API's.
    pub path: &'static str,
    /// Whether it begins a command, whose end is told later.
    pub is_command: bool,
}

/// The headers that any operation understands, and that say the same as fields of some.
pub const WSG_LEASE: HeaderName = HeaderName::from_static("wsg-lease");
/// See [`WSG_LEASE`].
pub const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");

/// How long a command is waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wait<'a> {
    /// Not at all: it is answered when it was admitted.
    No,
    /// As long as over HTTP: so many ms, or as long as where nothing is said; by a client who is, or is not, seen meanwhile.
    Ms(Option<&'a str>, Presence),
}

/// The names of FAST STOPs: whatever comes with one, it stops.
const FAST_STOPS: [&str; 2] = ["fast-stop", "fleet.fast-stop"];

/// Whether a method is a FAST STOP.
#[must_use]
pub fn is_fast_stop(name: &str) -> bool {
    FAST_STOPS.contains(&name)
}

/// Before what a method goes. What only stops, or keeps or ends a lease, waits for nothing that moves or reads, and is
/// refused for nobody else.
#[must_use]
pub fn urgency(name: &str) -> Urgency {
    match name {
        name if is_fast_stop(name) => Urgency::FastStop,
        "stop" | "cancel" => Urgency::Stop,
        "lease.renew" | "lease.release" => Urgency::Lease,
        _ => Urgency::None,
    }
}

/// The FAST STOP that a text names which is no request.
#[must_use]
pub fn fast_stop_in(text: &str) -> Option<&'static str> {
    FAST_STOPS.into_iter().find(|name| text.contains(&format!("\"{name}\"")))
}

macro_rules! methods {
    (command) => { true };
    () => { false };
    ($($name:literal $verb:ident $path:literal $($command:ident)?;)*) => {
        &[$(Method { name: $name, verb: &Verb::$verb, path: $path, is_command: methods!($($command)?) }),*]
    };
}

/// All of them. Of those of one name the first counts whose path's parameters are all given.
pub const METHODS: &[Method] = methods! {
    "home" POST "/grippers/{gripper}/home" command;
    "move" POST "/grippers/{gripper}/move" command;
    "grip" POST "/grippers/{gripper}/grip" command;
    "release" POST "/grippers/{gripper}/release" command;
    "stop" POST "/grippers/{gripper}/stop" command;
    "fast-stop" POST "/grippers/{gripper}/fast-stop";
    "fast-stop" POST "/fast-stop";
    "acknowledge" POST "/grippers/{gripper}/acknowledge";
    "lease" GET "/grippers/{gripper}/lease";
    "lease.take" POST "/grippers/{gripper}/lease";
    "lease.renew" PUT "/grippers/{gripper}/lease";
    "lease.release" DELETE "/grippers/{gripper}/lease";
    "lease.hand-over" POST "/grippers/{gripper}/lease/hand-over";
    "command" GET "/grippers/{gripper}/commands/{command}";
    "cancel" POST "/grippers/{gripper}/commands/{command}/cancel" command;
    "grippers" GET "/grippers";
    "info" GET "/grippers/{gripper}";
    "state" GET "/grippers/{gripper}/state";
    "settings.acceleration" GET "/grippers/{gripper}/settings/acceleration";
    "settings.acceleration.set" PUT "/grippers/{gripper}/settings/acceleration";
    "settings.force-limit" GET "/grippers/{gripper}/settings/force-limit";
    "settings.force-limit.set" PUT "/grippers/{gripper}/settings/force-limit";
    "settings.soft-limits" GET "/grippers/{gripper}/settings/soft-limits";
    "settings.soft-limits.set" PUT "/grippers/{gripper}/settings/soft-limits";
    "settings.soft-limits.clear" DELETE "/grippers/{gripper}/settings/soft-limits";
    "settings.overdrive" GET "/grippers/{gripper}/settings/overdrive";
    "settings.overdrive.set" PUT "/grippers/{gripper}/settings/overdrive";
    "settings.device-tag" GET "/grippers/{gripper}/settings/device-tag";
    "settings.device-tag.set" PUT "/grippers/{gripper}/settings/device-tag";
    "statistics" GET "/grippers/{gripper}/statistics";
    "statistics.reset" POST "/grippers/{gripper}/statistics/reset";
    "fingers" GET "/grippers/{gripper}/fingers/{finger}";
    "fingers.data" GET "/grippers/{gripper}/fingers/{finger}/data";
    "fingers.power" PUT "/grippers/{gripper}/fingers/{finger}/power";
    "tare" POST "/grippers/{gripper}/tare";
    "loop" POST "/grippers/{gripper}/loop";
    "raw" POST "/grippers/{gripper}/raw" command;
    "fleet" GET "/fleet";
    "fleet.fast-stop" POST "/fleet/fast-stop";
};

impl Method {
    /// The one of a route, by its verb and its template.
    pub fn of_route(verb: &Verb, route: &str) -> Option<&'static Self> {
        let path = route.strip_prefix(API)?;
        METHODS.iter().find(|method| method.verb == verb && method.path == path)
    }

    /// Whether it has a `wait_ms`.
    pub fn waits(&self) -> bool {
        self.is_command || self.name == "command"
    }

    /// The parameters that its path names, in their order.
    pub fn path_parameters(&self) -> impl Iterator<Item = &'static str> {
        self.path.split('/').filter_map(|part| part.strip_prefix('{')?.strip_suffix('}'))
    }
}

/// An operation's answer.
#[derive(Debug)]
pub struct Answer {
    /// Its body.
    pub body: Box<RawValue>,
    /// The command that was begun, and has not ended.
    pub running: Option<Ticket>,
    /// The lease that was taken.
    pub lease: Option<Arc<Taken>>,
}

/// What an operation was refused with.
#[derive(Debug)]
pub struct Refusal {
    /// The problem's status.
    pub status: StatusCode,
    /// The problem.
    pub problem: Box<RawValue>,
}

impl From<Problem> for Refusal {
    fn from(problem: Problem) -> Self {
        let problem = problem.members();
        Self { status: problem.status(), problem: serde_json::value::to_raw_value(problem).unwrap_or_default() }
    }
}

/// Whoever can call them.
#[derive(Debug, Clone)]
pub struct Methods(Arc<Router>);

impl Methods {
    /// Of the API's router.
    pub fn new(router: Router) -> Self {
        Self(Arc::new(router))
    }

    /// Whether there is one of this name.
    pub fn has(name: &str) -> bool {
        METHODS.iter().any(|method| method.name == name)
    }

    /// Calls one for a client. The headers are those of the request that it is. A FAST STOP of a gripper that isn't known
    /// stops all: the one that is meant is among them.
    ///
    /// # Errors
    /// [`Refusal`], as the operation has it.
    pub async fn call(
        &self,
        client: Client,
        name: &str,
        params: Value,
        wait: Wait<'_>,
        headers: HeaderMap,
    ) -> Result<Answer, Refusal> {
        let of_all = is_fast_stop(name).then(|| json!({"reason": params.get("reason")}));
        let answer = match request(name, params, wait) {
            Ok(mut asked) => {
                *asked.headers_mut() = headers;
                self.send(client.clone(), asked).await
            }
            Err(problem) => Err(problem.into()),
        };
        match (answer, of_all) {
            (Err(_), Some(params)) => self.send(client, request(name, params, Wait::No)?).await,
            (answer, _) => answer,
        }
    }

    /// Asks for an operation by its path.
    pub async fn forward(&self, client: Client, mut request: Request<Body>) -> Response {
        request.extensions_mut().insert(client);
        let Ok(response) = Router::clone(&self.0).oneshot(request).await;
        response
    }

    async fn send(&self, client: Client, request: Request<Body>) -> Result<Answer, Refusal> {
        let (mut parts, body) = self.forward(client, request).await.into_parts();
        let broken = |detail: String| Problem::new(Code::Internal, format!("the answer can't be told: {detail}"));
        let bytes = body.collect().await.map_err(|error| broken(error.to_string()))?.to_bytes();
        let body: Box<RawValue> = serde_json::from_slice(&bytes).map_err(|error| broken(error.to_string()))?;
        if parts.status.is_success() {
            let (running, lease) = (parts.extensions.remove(), parts.extensions.remove());
            Ok(Answer { body, running, lease })
        } else {
            Err(Refusal { status: parts.status, problem: body })
        }
    }
}

/// The request that a method is.
fn request(name: &str, params: Value, wait: Wait<'_>) -> Result<Request<Body>, Problem> {
    let rows = || METHODS.iter().filter(|method| method.name == name);
    let first = rows().next().ok_or_else(|| Problem::not_found(format!("method {:?}", shortened(name))))?;
    let mut params = match params {
        Value::Object(params) => params,
        Value::Null => Map::new(),
        _ if is_fast_stop(name) => Map::new(),
        _ => return Err(Problem::malformed("params", "params must be an object: there are none by position")),
    };
    let method = rows().find(|row| row.path_parameters().all(|key| params.contains_key(key))).unwrap_or(first);
    let mut path = API.to_owned();
    for part in method.path.split('/').filter(|part| !part.is_empty()) {
        path.push('/');
        match part.strip_prefix('{').and_then(|part| part.strip_suffix('}')) {
            Some(key) => path.push_str(&path_part(key, params.remove(key))?),
            None => path.push_str(part),
        }
    }
    match wait {
        Wait::No if method.is_command => path.push_str("?wait_ms=0"),
        Wait::Ms(Some(wait_ms), _) => {
            path.push_str("?wait_ms=");
            path.push_str(&form_urlencoded(wait_ms));
        }
        _ => {}
    }
    let has_body = *method.verb != Verb::GET;
    if let (false, Some(field)) = (has_body, params.keys().next()) {
        let field = shortened(field);
        return Err(Problem::malformed(&field, format!("unknown field `{field}`: {name} has none of this name")));
    }
    let body = if has_body { Body::from(Value::Object(params).to_string()) } else { Body::empty() };
    let mut request = Request::builder().method(method.verb).uri(path);
    if let Wait::Ms(_, presence) = wait {
        request = request.extension(presence);
    }
    let request = request.body(body);
    request.map_err(|error| Problem::new(Code::Internal, format!("no request: {error}")))
}

/// A parameter as a part of a path. What can't be one is nothing's name.
fn path_part(key: &str, value: Option<Value>) -> Result<String, Problem> {
    let part = match value {
        Some(Value::String(text)) => text,
        Some(Value::Number(number)) => number.to_string(),
        Some(_) => return Err(Problem::malformed(key, format!("{key} must be a text or a number"))),
        None => return Err(Problem::malformed(key, format!("missing field `{key}`"))),
    };
    let is_name = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_');
    if part.is_empty() || !part.bytes().all(is_name) {
        return Err(Problem::not_found(format!("such {key}")));
    }
    Ok(part)
}

/// As a value in an address.
fn form_urlencoded(text: &str) -> String {
    url::form_urlencoded::byte_serialize(text.as_bytes()).collect()
}

/// As much of what a client sent as is repeated to it.
fn shortened(text: &str) -> String {
    text.chars().take(32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(name: &str, params: Value) -> String {
        let request = request(name, params, Wait::No).unwrap();
        format!("{} {}", request.method(), request.uri())
    }

    fn refused(name: &str, params: Value) -> Value {
        serde_json::to_value(request(name, params, Wait::No).unwrap_err().members()).unwrap()
    }

    #[test]
    fn a_method_is_its_operation_and_a_command_does_not_wait() {
        let gripper = json!({"gripper": "left", "width_mm": 20});
        assert_eq!(line("grip", gripper.clone()), "POST /api/v1/grippers/left/grip?wait_ms=0");
        assert_eq!(line("settings.force-limit.set", gripper), "PUT /api/v1/grippers/left/settings/force-limit");
        let finger = json!({"gripper": "left", "finger": 2});
        assert_eq!(line("fingers.data", finger), "GET /api/v1/grippers/left/fingers/2/data");
    }

    #[test]
    fn a_command_is_waited_for_as_its_door_says() {
        let uri = |wait| request("home", json!({"gripper": "left"}), wait).unwrap().uri().to_string();
        let ms = |ms| Wait::Ms(ms, Presence::Unseen);
        assert_eq!(uri(ms(None)), "/api/v1/grippers/left/home");
        assert_eq!(uri(ms(Some("60000"))), "/api/v1/grippers/left/home?wait_ms=60000");
        assert_eq!(uri(ms(Some("1 &#"))), "/api/v1/grippers/left/home?wait_ms=1+%26%23");
    }

    #[test]
    fn a_fast_stop_stops_one_or_all_whatever_comes_with_it() {
        assert_eq!(line("fast-stop", json!({"gripper": "left"})), "POST /api/v1/grippers/left/fast-stop");
        for params in [json!({}), Value::Null, json!([1, 2]), json!("now"), json!({"reason": 7})] {
            assert_eq!(line("fast-stop", params), "POST /api/v1/fast-stop");
        }
    }

    #[test]
    fn what_is_missing_or_can_be_no_part_of_a_path_is_named() {
        assert_eq!(refused("grip", json!({"width_mm": 20}))["field"], "gripper");
        assert_eq!(refused("grip", json!(["left", 20]))["field"], "params");
        assert_eq!(refused("state", json!({"gripper": "left", "width_mm": 20}))["field"], "width_mm");
        for name in ["", "../left", "left/grip", "left?x=1", "l\u{f6}ft"] {
            assert_eq!(refused("state", json!({"gripper": name}))["code"], "not_found", "{name}");
        }
        assert_eq!(refused("leap", json!({}))["code"], "not_found");
    }

    #[test]
    fn every_method_is_an_operation_and_every_operation_on_a_gripper_is_a_method() {
        let document = serde_json::to_value(super::super::openapi()).unwrap();
        let paths = document["paths"].as_object().unwrap();
        for method in METHODS {
            let operation = &paths[&format!("{API}{}", method.path)][method.verb.as_str().to_lowercase()];
            assert!(operation.is_object(), "{}", method.name);
        }
        for (path, item) in paths.iter().filter(|(path, _)| path.starts_with("/api/v1/grippers/")) {
            for verb in item.as_object().unwrap().keys() {
                let is_it = |method: &&Method| {
                    format!("{API}{}", method.path) == *path && method.verb.as_str().eq_ignore_ascii_case(verb)
                };
                assert!(METHODS.iter().any(|method| is_it(&method)), "{verb} {path} is no method");
            }
        }
    }
}
