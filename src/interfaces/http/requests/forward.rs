//! Requests for a gripper of any gateway. A request for another gateway's gripper goes to the gateway that owns it,
//! which decides. Its responses and problems are returned unchanged.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body as Stream, Bytes};
use axum::extract::{RawPathParams, Request, State as Shared};
use axum::http::request::Parts;
use axum::http::{HeaderName, Method as Verb, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::value::RawValue;
use serde_json::{Map, Value};
use tokio::time::timeout;

use super::body;
use super::fast_stop::{REASON_TIME, with_reason};
use super::operation::{RequestBody, path_parameter, query, serve_below};
use super::problem::{PROBLEM_JSON, RETRY_AFTER_S};
use super::requested_operation::Asked;
use super::unknown_path::{no_such_path, unknown_path};
use super::visitor::Identified;
use crate::access::Credential;
use crate::connections::admission::{Class, ConnectionPermit};
use crate::fleet::{PeerRequest, TOKEN};
use crate::interfaces::http::context::{API, HttpContext};
use crate::model::{Door, Name, Reason, Urgency};
use crate::operations::fleet::no_answer;
use crate::operations::parameters::json::{parse, text_member};
use crate::operations::parameters::values::text;
use crate::operations::{
    Code, DEFAULT_WAIT_MS, MAX_LEASE_BYTES, Operation, Problem, QueryString, all, check, note_use, wait_ms,
};

/// Paths of the grippers of any gateway.
pub const PATHS: [&str; 2] =
    ["/fleet/{gateway}/grippers/{gripper}", "/fleet/{gateway}/grippers/{gripper}/{*operation}"];

/// Headers that are forwarded along with the parameters, and their parameter names.
const HEADER_PARAMS: [(HeaderName, &str); 2] =
    [(HeaderName::from_static("wsg-lease"), "lease"), (HeaderName::from_static("idempotency-key"), "request_id")];

/// The parts of a path below a gripper of the fleet.
struct Target {
    gateway: Name,
    gripper: String,
    /// Rest of the path after the gripper, with its leading slash.
    operation: String,
}

impl Target {
    fn of(parameters: &RawPathParams) -> Result<Self, Problem> {
        let gateway = path_parameter(parameters, "gateway").ok_or_else(no_such_path)?;
        Ok(Self {
            gateway: gateway.parse().map_err(|_| Problem::not_found("gateway with this name"))?,
            gripper: path_parameter(parameters, "gripper").ok_or_else(no_such_path)?.to_owned(),
            operation: match path_parameter(parameters, "operation") {
                // A FAST STOP with a trailing slash is accepted everywhere.
                Some(operation) if operation.ends_with("fast-stop/") => "/fast-stop".to_owned(),
                Some(operation) => format!("/{operation}"),
                None => String::new(),
            },
        })
    }
}

/// Performs any operation on a gripper of any gateway.
pub async fn forward(
    Shared(context): Shared<Arc<HttpContext>>,
    parameters: RawPathParams,
    request: Request,
) -> Result<Response, Problem> {
    let target = Target::of(&parameters)?;
    let (parts, stream) = request.into_parts();
    let Some((operation, mut path)) = operation(&parts, &target.operation)? else {
        return Ok(not_allowed(&parts, &target.operation));
    };
    // The parameters are decoded: an operation whose name is percent-encoded would have lost its urgency.
    let asked: Asked = parts.extensions.get().copied().unwrap_or_default();
    if !asked.is(operation) {
        return Err(unknown_path(parts.uri.path()));
    }
    if context.gateway.peers.is_own(&target.gateway) {
        path.insert("gripper", target.gripper);
        return serve_below(&context, operation, path, &parts, RequestBody::Stream(stream)).await;
    }
    let gripper = target.gripper.parse().map_err(|_| Problem::not_found("gripper with this name"))?;
    let identified = Identified::client_of(&context.gateway.access, &parts.extensions);
    // The rights to one of this gateway's grippers say nothing about another gateway's gripper of the same name.
    check(&context.gateway.access, operation.right, &identified.identity, None)?;
    note_use(&context.gateway.access, operation, &identified.identity);
    let mut wait = wait(&parts, operation)?;
    let mut aside = aside(&parts);
    if operation.ignores_mistakes {
        aside.retain(|(name, value)| text::<MAX_LEASE_BYTES>(name, value).is_ok());
    }
    // The other gateway may not know the token, and a FAST STOP must not fail because of that.
    if operation.urgency != Urgency::FastStop
        && let Credential::Token(token) = &identified.visitor.credential
    {
        aside.push((TOKEN, token.expose().to_owned()));
    }
    let permit: Option<Arc<ConnectionPermit>> = parts.extensions.get().cloned();
    let long_wait = wait.filter(|wait| !wait.is_zero());
    let _claim = match (&permit, long_wait) {
        (Some(permit), Some(_)) => {
            let claim = permit.claim(Class::Waiting);
            wait = if claim.is_some() { long_wait } else { Some(Duration::ZERO) };
            claim
        }
        _ => None,
    };
    let gateway = target.gateway.clone();
    let client = identified.client(Door::Http);
    let urgency = operation.urgency;
    let ask = move |params| async move {
        let method = operation.name;
        let params = Value::Object(params);
        context
            .gateway
            .peers
            .ask(PeerRequest { gateway, gripper: Some(gripper), method, params, wait, aside, client, urgency })
            .await
    };
    let asked = if urgency == Urgency::FastStop {
        with_reason(stream, permit, async |text: Bytes| ask(reason_in(&text)).await).await
    } else {
        let mut params = if operation.changes_something() { Map::new() } else { query(&parts.uri, operation)? };
        params.extend(fields_of(operation, stream, path).await?);
        ask(params).await
    };
    match asked {
        Ok(Ok(answer)) => Ok(answered(&target.gateway, operation, &answer)),
        Ok(Err((status, problem))) => Ok(refused(status, &problem)),
        Err(why) => Err(no_answer(&target.gateway, why)),
    }
}

/// Returns the parameters of a FAST STOP: the reason in its body.
fn reason_in(body: &[u8]) -> Map<String, Value> {
    let reason = Reason::truncated(&text_member(body, "reason").unwrap_or_default());
    Map::from_iter([("reason".to_owned(), reason.as_str().into())])
}

/// Returns the fields of a request. A Stop happens whatever its body says and however long the body takes.
async fn fields_of(
    operation: &Operation,
    stream: Stream,
    path: BTreeMap<&'static str, String>,
) -> Result<Map<String, Value>, Problem> {
    let fields = fields(stream, path);
    if operation.ignores_mistakes {
        return Ok(timeout(REASON_TIME, fields).await.ok().and_then(Result::ok).unwrap_or_default());
    }
    fields.await
}

async fn fields(stream: Stream, path: BTreeMap<&'static str, String>) -> Result<Map<String, Value>, Problem> {
    let mut fields: Map<String, Value> = parse(&body::bytes(stream).await?)?;
    // Like the gateway's own paths: path parameters must not appear in the body.
    if let Some(field) = fields.keys().find(|key| path.contains_key(key.as_str()) || *key == "gripper") {
        return Err(Problem::malformed(field, format!("unknown field {field}: the path already names it")));
    }
    fields.extend(path.into_iter().map(|(key, value)| (key.to_owned(), value.into())));
    Ok(fields)
}

fn aside(parts: &Parts) -> Vec<(&'static str, String)> {
    let mut aside = Vec::new();
    for (header, name) in HEADER_PARAMS {
        if let Some(value) = parts.headers.get(header) {
            aside.push((name, String::from_utf8_lossy(value.as_bytes()).into_owned()));
        }
    }
    aside
}

/// An operation, and the parameters in its path.
type Found = (&'static Operation, BTreeMap<&'static str, String>);

/// Finds the operation of a path below a gripper. Returns `None` if the path exists but does not take the method.
fn operation(parts: &Parts, path: &str) -> Result<Option<Found>, Problem> {
    let mut of_path = all().filter_map(|operation| Some((operation, parameters_of(operation, path)?))).peekable();
    of_path.peek().ok_or_else(|| unknown_path(parts.uri.path()))?;
    let verb = if parts.method == Verb::HEAD { &Verb::GET } else { &parts.method };
    // The path of the newest command is also that of a command with the id `latest`.
    let of_verb = of_path.filter(|(operation, _)| operation.verb == verb);
    Ok(of_verb.min_by_key(|(operation, _)| operation.path_parameters().count()))
}

fn not_allowed(parts: &Parts, path: &str) -> Response {
    let of_path = all().filter(|operation| parameters_of(operation, path).is_some());
    let allowed: Vec<_> = of_path.map(|operation| operation.verb.as_str()).collect();
    let detail = format!("method {} is not allowed here; see the Allow header", parts.method);
    ([(header::ALLOW, allowed.join(","))], Problem::new(Code::MethodNotAllowed, detail)).into_response()
}

fn parameters_of(operation: &Operation, path: &str) -> Option<BTreeMap<&'static str, String>> {
    let template = operation.path.strip_prefix("/grippers/{gripper}")?;
    if template.split('/').count() != path.split('/').count() {
        return None;
    }
    let mut parameters = BTreeMap::new();
    for (part, given) in template.split('/').zip(path.split('/')) {
        match part.strip_prefix('{').and_then(|part| part.strip_suffix('}')) {
            Some(key) => drop(parameters.insert(key, given.to_owned())),
            None if part == given => {}
            None => return None,
        }
    }
    Some(parameters)
}

/// Returns the time that the operation may wait; `None` if it does not wait.
fn wait(parts: &Parts, operation: &Operation) -> Result<Option<Duration>, Problem> {
    if !operation.waits {
        return Ok(None);
    }
    let given = QueryString::of(&parts.uri).one("wait_ms").and_then(|given| given.map(wait_ms).transpose());
    let given = if operation.ignores_mistakes { given.unwrap_or_default() } else { given? };
    Ok(given.or(operation.starts_command.then_some(DEFAULT_WAIT_MS)).map(Duration::from_millis))
}

/// Builds the response that the owner would send: 200 for a read, and 202 with a Location while a command is running.
fn answered(gateway: &Name, operation: &Operation, answer: &RawValue) -> Response {
    let json = [(header::CONTENT_TYPE, "application/json".to_owned())];
    if !operation.changes_something() {
        return (json, answer.get().to_owned()).into_response();
    }
    let command: Value = serde_json::from_str(answer.get()).unwrap_or_default();
    if command["place"].is_u64() {
        return (StatusCode::ACCEPTED, json, answer.get().to_owned()).into_response();
    }
    if command["phase"] != "running" {
        return (json, answer.get().to_owned()).into_response();
    }
    let gripper = command["gripper"].as_str().unwrap_or_default();
    let id = command["id"].as_str().unwrap_or_default();
    let location = format!("{API}/fleet/{gateway}/grippers/{gripper}/commands/{id}");
    (StatusCode::ACCEPTED, [(header::LOCATION, location)], json, answer.get().to_owned()).into_response()
}

fn refused(status: u16, problem: &RawValue) -> Response {
    let status =
        StatusCode::from_u16(status).ok().filter(|status| status.is_client_error() || status.is_server_error());
    let status = status.unwrap_or(StatusCode::BAD_GATEWAY);
    let mut response = (status, [(header::CONTENT_TYPE, PROBLEM_JSON)], problem.get().to_owned()).into_response();
    if status == StatusCode::TOO_MANY_REQUESTS {
        response.headers_mut().insert(header::RETRY_AFTER, RETRY_AFTER_S);
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operations::gripper::{commands, motion};

    #[test]
    fn only_a_started_command_is_accepted() {
        let running =
            RawValue::from_string(r#"{"id": "1", "gripper": "left", "phase": "running"}"#.to_owned()).unwrap();
        for (operation, status) in [(&motion::HOME, 202), (&commands::CANCEL, 202), (&commands::GET, 200)] {
            let response = answered(&"other".parse().unwrap(), operation, &running);
            assert_eq!(response.status(), status, "{}", operation.name);
            assert_eq!(response.headers().contains_key(header::LOCATION), status == 202, "{}", operation.name);
        }
    }

    #[test]
    fn forwarded_overload_says_when_to_try_again() {
        let problem = RawValue::from_string("{}".to_owned()).unwrap();
        for (status, expected) in [(429, 429), (409, 409), (200, 502)] {
            let response = refused(status, &problem);
            assert_eq!(response.status(), expected);
            assert_eq!(response.headers().contains_key(header::RETRY_AFTER), status == 429, "{status}");
        }
    }

    #[test]
    fn forwarded_stop_ignores_an_invalid_wait() {
        for query in ["wait_ms=soon", "wait_ms=1&wait_ms=2", "wait_ms=70000"] {
            let request = Request::post(format!("/stop?{query}")).body(Stream::empty()).unwrap();
            let (parts, _) = request.into_parts();
            assert_eq!(wait(&parts, &motion::STOP).unwrap(), Some(Duration::from_millis(DEFAULT_WAIT_MS)), "{query}");
            assert!(wait(&parts, &motion::HOME).is_err(), "{query}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn forwarded_stop_does_not_wait_for_its_body() {
        let never = Stream::from_stream(futures_util::stream::pending::<Result<&[u8], std::io::Error>>());
        let start = tokio::time::Instant::now();
        assert_eq!(fields_of(&motion::STOP, never, BTreeMap::new()).await.unwrap(), Map::new());
        assert!(start.elapsed() <= REASON_TIME);
    }
}
