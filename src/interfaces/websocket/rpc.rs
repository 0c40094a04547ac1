//! JSON-RPC 2.0: parses requests and builds responses.

use http::StatusCode;
use serde::Serialize;
use serde_json::Value;
use serde_json::value::RawValue;

use crate::model::without_byte_order_mark;
use crate::operations::parameters::json::{self, MAX_BODY_BYTES, StrictJson};
use crate::operations::{Code, Method, Problem, all};

/// Maximum number of requests in a batch.
pub const MAX_BATCH: usize = 32;

/// Maximum length of a request's id, in bytes.
pub const MAX_ID_BYTES: usize = 64;

const VERSION: &str = "2.0";

/// Method that has no operation: it concerns only its own socket.
const SUBSCRIBE: &str = "subscribe";

const PARSE_ERROR: i32 = -32700;
const INVALID_REQUEST: i32 = -32600;
const METHOD_NOT_FOUND: i32 = -32601;
const INVALID_PARAMS: i32 = -32602;
const INTERNAL_ERROR: i32 = -32603;
/// Code of all other refusals; the problem's `code` says why.
const REFUSED: i32 = -32000;

/// Method that a request asks for.
#[derive(Debug)]
pub enum RpcMethod {
    Subscribe,
    Operation(Method),
    /// A method that does not exist, with the problem that says so.
    Unknown(Problem),
}

#[derive(Debug)]
pub struct RpcCall {
    /// Id of the request; `None` for a notification, which gets no response.
    pub id: Option<Value>,
    pub method: RpcMethod,
    pub params: Value,
    /// Label of the client's user.
    pub label: Option<String>,
}

#[derive(Debug)]
pub enum Incoming {
    /// A request, or the response that refuses it.
    One(Result<RpcCall, RpcResponse>),
    Batch(Vec<Result<RpcCall, RpcResponse>>),
}

#[derive(Debug, Serialize)]
pub struct RpcError {
    code: i32,
    message: String,
    data: Problem,
}

#[derive(Debug, Serialize)]
pub struct RpcResponse {
    jsonrpc: &'static str,
    id: Value,
    #[serde(flatten)]
    outcome: Outcome,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "lowercase")]
enum Outcome {
    Result(Box<RawValue>),
    Error(RpcError),
}

impl RpcMethod {
    fn named(name: &str) -> Self {
        if name == SUBSCRIBE {
            return Self::Subscribe;
        }
        Method::named(name).map_or_else(Self::Unknown, Self::Operation)
    }

    pub fn is_fast_stop(&self) -> bool {
        matches!(self, Self::Operation(method) if method.is_fast_stop())
    }
}

impl RpcResponse {
    pub fn new(id: Value, outcome: Result<Box<RawValue>, RpcError>) -> Self {
        let outcome = match outcome {
            Ok(result) => Outcome::Result(result),
            Err(error) => Outcome::Error(error),
        };
        Self { jsonrpc: VERSION, id, outcome }
    }

    fn invalid(id: Value, code: i32, problem: Problem) -> Self {
        Self::new(id, Err(RpcError::with_code(code, problem)))
    }
}

impl RpcError {
    pub fn no_method(problem: Problem) -> Self {
        Self::with_code(METHOD_NOT_FOUND, problem)
    }

    fn with_code(code: i32, problem: Problem) -> Self {
        Self { code, message: problem.detail().to_owned(), data: problem }
    }
}

impl From<Problem> for RpcError {
    fn from(problem: Problem) -> Self {
        let code = match problem.status() {
            StatusCode::BAD_REQUEST => INVALID_PARAMS,
            // A problem names a field only if that parameter is wrong.
            _ if problem.members().field().is_some() => INVALID_PARAMS,
            StatusCode::INTERNAL_SERVER_ERROR => INTERNAL_ERROR,
            _ => REFUSED,
        };
        Self::with_code(code, problem)
    }
}

/// Returns the FAST STOP method that an invalid message names.
fn fast_stop_in(text: &str) -> Option<Method> {
    let mut methods = all().map(Method::from).filter(|method| method.is_fast_stop());
    methods.find(|method| text.contains(&format!("\"{}\"", method.name())))
}

/// Whether a text names a FAST STOP, well-formed or not.
pub fn has_fast_stop(text: &str) -> bool {
    fast_stop_in(text).is_some()
}

/// Parses a message. An invalid or oversized message that names a FAST STOP is a FAST STOP of all grippers.
pub fn parse(text: &str) -> Incoming {
    if text.len() > MAX_BODY_BYTES {
        let detail = format!("the message has {} bytes; at most {MAX_BODY_BYTES} are allowed", text.len());
        return invalid_message(text, INVALID_REQUEST, Problem::new(Code::TooLarge, detail));
    }
    match serde_json::from_slice(without_byte_order_mark(text.as_bytes())).map(|StrictJson(message)| message) {
        Err(error) => {
            let code = if error.is_data() { INVALID_REQUEST } else { PARSE_ERROR };
            invalid_message(text, code, json::invalid("JSON", &error))
        }
        Ok(Value::Array(batch)) if batch.is_empty() => {
            invalid_message(text, INVALID_REQUEST, malformed("the batch is empty".to_owned()))
        }
        Ok(Value::Array(batch)) if batch.len() > MAX_BATCH => {
            let detail = format!("the batch has {} requests; at most {MAX_BATCH} are allowed", batch.len());
            invalid_message(text, INVALID_REQUEST, malformed(detail))
        }
        Ok(Value::Array(batch)) => {
            let mut calls: Vec<_> = batch.into_iter().map(call).collect();
            if !calls.iter().any(is_fast_stop)
                && let Some(invalid) = calls.iter_mut().find(|call| call.is_err())
                && let Some(fast_stop) = fast_stop_of_all(text)
            {
                *invalid = Ok(fast_stop);
            }
            Incoming::Batch(calls)
        }
        Ok(one) => Incoming::One(call(one).or_else(|refused| fast_stop_of_all(text).ok_or(refused))),
    }
}

pub fn is_fast_stop(call: &Result<RpcCall, RpcResponse>) -> bool {
    call.as_ref().is_ok_and(|call| call.method.is_fast_stop())
}

/// Refuses a message as invalid, unless it names a FAST STOP.
fn invalid_message(text: &str, code: i32, problem: Problem) -> Incoming {
    Incoming::One(fast_stop_of_all(text).ok_or_else(|| RpcResponse::invalid(Value::Null, code, problem)))
}

/// Returns the FAST STOP of all grippers that an invalid message counts as, if it names one.
fn fast_stop_of_all(text: &str) -> Option<RpcCall> {
    let method = RpcMethod::Operation(fast_stop_in(text)?);
    Some(RpcCall { id: Some(Value::Null), method, params: Value::Null, label: None })
}

/// Parses a request. A request for a FAST STOP is accepted even if malformed.
fn call(mut request: Value) -> Result<RpcCall, RpcResponse> {
    let version = take(&mut request, "jsonrpc");
    let id = take(&mut request, "id");
    let method = take(&mut request, "method");
    let params = take(&mut request, "params").unwrap_or_default();
    let label = match take(&mut request, "client") {
        Some(Value::String(label)) => Some(label),
        _ => None,
    };
    let known_id = id.as_ref().filter(|id| is_id(id)).cloned();
    let method = match method.as_ref().and_then(Value::as_str).map(RpcMethod::named) {
        Some(method) if method.is_fast_stop() => return Ok(RpcCall { id: known_id, method, params, label }),
        method => method,
    };
    let detail = match method {
        _ if version.as_ref().and_then(Value::as_str) != Some(VERSION) => "jsonrpc must be \"2.0\"",
        _ if known_id.is_none() && id.is_some() => "id must be a string of at most 64 bytes or an integer below 2^64",
        Some(method) => return Ok(RpcCall { id, method, params, label }),
        None => "method must be a string",
    };
    Err(RpcResponse::invalid(known_id.unwrap_or_default(), INVALID_REQUEST, malformed(detail.to_owned())))
}

fn take(request: &mut Value, key: &str) -> Option<Value> {
    request.get_mut(key).map(Value::take)
}

/// Whether a request can have this id. A number that can't be repeated exactly identifies nothing, and a long string
/// would be kept until the response is read.
fn is_id(id: &Value) -> bool {
    match id {
        Value::String(text) => text.len() <= MAX_ID_BYTES,
        id => id.is_i64() || id.is_u64() || id.is_null(),
    }
}

fn malformed(detail: String) -> Problem {
    Problem::new(Code::Malformed, detail)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn method(call: &RpcCall) -> &str {
        match &call.method {
            RpcMethod::Operation(method) => method.name(),
            other => panic!("{other:?}"),
        }
    }

    fn one(request: &Value) -> Result<RpcCall, Value> {
        match parse(&request.to_string()) {
            Incoming::One(one) => one.map_err(|answer| serde_json::to_value(answer).unwrap()),
            Incoming::Batch(_) => panic!("a batch"),
        }
    }

    #[test]
    fn notification_has_no_id() {
        let request = one(&json!({"jsonrpc": "2.0", "id": "a", "method": "state", "params": {"gripper": "left"}}));
        let params = json!({"gripper": "left"});
        let request = request.unwrap();
        assert_eq!((request.id.clone(), method(&request), &request.params), (Some("a".into()), "state", &params));
        assert_eq!(one(&json!({"jsonrpc": "2.0", "method": "state"})).unwrap().id, None);
    }

    #[test]
    fn byte_order_mark_is_ignored() {
        let request = json!({"jsonrpc": "2.0", "id": 1, "method": "state"}).to_string();
        let Incoming::One(Ok(call)) = parse(&format!("\u{feff}{request}")) else { panic!("{request}") };
        assert_eq!(method(&call), "state");
    }

    #[test]
    fn label_of_any_form_stops_no_request() {
        for (given, label) in [(json!("Anna"), Some("Anna")), (json!(7), None), (json!(null), None)] {
            for method in ["state", "fast-stop"] {
                let request = one(&json!({"jsonrpc": "2.0", "id": 1, "method": method, "client": given})).unwrap();
                assert_eq!(request.label.as_deref(), label);
            }
        }
    }

    #[test]
    fn invalid_request_is_refused_with_its_id() {
        for (request, id) in [
            (json!({"id": 7, "method": "state"}), json!(7)),
            (json!({"jsonrpc": "1.0", "id": 7, "method": "state"}), json!(7)),
            (json!({"jsonrpc": "2.0", "id": 7}), json!(7)),
            (json!({"jsonrpc": "2.0", "id": 7, "method": 1}), json!(7)),
            (json!({"jsonrpc": "2.0", "id": {}, "method": "state"}), Value::Null),
            (json!({"jsonrpc": "2.0", "id": 1e29, "method": "state"}), Value::Null),
            (json!({"jsonrpc": "2.0", "id": "x".repeat(65), "method": "state"}), Value::Null),
            (json!("state"), Value::Null),
            (json!([]), Value::Null),
        ] {
            let answer = one(&request).unwrap_err();
            assert_eq!((&answer["error"]["code"], &answer["id"]), (&json!(-32600), &id), "{request}");
            assert_eq!(answer["error"]["data"]["code"], "malformed");
        }
        let Incoming::One(Err(answer)) = parse("{\"jsonrpc\"") else { panic!() };
        assert_eq!(serde_json::to_value(answer).unwrap()["error"]["code"], -32700);
        assert!(matches!(parse(&json!(vec![1; MAX_BATCH + 1]).to_string()), Incoming::One(Err(_))));
        let Incoming::One(Err(answer)) = parse(r#"{"jsonrpc": "2.0", "id": 1, "id": 2, "method": "state"}"#) else {
            panic!()
        };
        let error = serde_json::to_value(answer).unwrap()["error"].take();
        assert!(error["code"] == -32600 && error["message"].as_str().unwrap().contains("id is given"), "{error}");
    }

    #[test]
    fn wrong_parameters_are_invalid_params() {
        let code = |problem: Problem| RpcError::from(problem).code;
        assert_eq!(code(Problem::malformed("width_mm", "width_mm is missing")), INVALID_PARAMS);
        assert_eq!(code(Problem::out_of_range("width_mm", 300.0, 0.0, 110.0)), INVALID_PARAMS);
        assert_eq!(code(Problem::too_long("part_id", 64, 48)), INVALID_PARAMS);
        assert_eq!(code(Problem::not_found("gripper is named h").field("gripper")), INVALID_PARAMS);
        assert_eq!(code(Problem::new(Code::NotReferenced, "home first")), REFUSED);
        assert_eq!(code(Problem::not_found("command with this id")), REFUSED);
    }

    #[test]
    fn malformed_fast_stop_is_accepted() {
        for request in [json!({"method": "fast-stop"}), json!({"jsonrpc": 2, "id": [], "method": "fast-stop"})] {
            assert_eq!(method(&one(&request).unwrap()), "fast-stop");
        }
        assert_eq!(method(&one(&json!({"method": "fleet.fast-stop"})).unwrap()), "fleet.fast-stop");
        for request in
            [json!("fast-stop"), json!({"params": {"method": "fast-stop"}}), json!({"method": ["fast-stop"]})]
        {
            assert_eq!(method(&one(&request).unwrap()), "fast-stop", "{request}");
        }
        let batch = json!([{"jsonrpc": "2.0", "id": 1, "method": "state"}, ["fast-stop"], 7]);
        let Incoming::Batch(calls) = parse(&batch.to_string()) else { panic!("{batch}") };
        let methods: Vec<_> = calls.iter().map(|call| call.as_ref().map(method).ok()).collect();
        assert_eq!(methods, [Some("state"), Some("fast-stop"), None]);
        let request = r#"{"jsonrpc": "2.0", "id": 1, "method": "fast-stop", "params": {"gripper": "left"}}"#;
        let batch = format!("[{}]", [request; MAX_BATCH + 1].join(","));
        let nested = format!("{}{request}", "[".repeat(200));
        for text in [
            &batch,
            &nested,
            &format!("{request}}}"),
            &request.replace('1', "1, \"id\": 2"),
            &request.replace("left", &"x".repeat(MAX_BODY_BYTES)),
        ] {
            let Incoming::One(Ok(call)) = parse(text) else { panic!("{text}") };
            assert_eq!((method(&call), &call.id, &call.params), ("fast-stop", &Some(Value::Null), &Value::Null));
        }
    }
}
