//! Fuzz target of JSON-RPC.

use serde_json::Value;

use super::rpc::{self, Incoming, MAX_BATCH};
use crate::operations::Method;
use crate::operations::parameters::json::StrictJson;

fn is_fast_stop(name: &str) -> bool {
    Method::named(name).is_ok_and(Method::is_fast_stop)
}

/// Checks a message. A FAST STOP is not refused, even in malformed JSON. A batch is bounded. Each refusal can be encoded.
pub(crate) fn message(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let value = serde_json::from_str(text).ok().map(|StrictJson(value)| value);
    let method = value.as_ref().and_then(|value| value.get("method")).and_then(Value::as_str);
    let has_to_stop = if value.is_some() { method.is_some_and(is_fast_stop) } else { rpc::has_fast_stop(text) };
    let calls = match rpc::parse(text) {
        Incoming::One(call) => {
            assert!(!has_to_stop || rpc::is_fast_stop(&call), "a FAST STOP was refused: {call:?}");
            vec![call]
        }
        Incoming::Batch(calls) => {
            assert!(!has_to_stop && calls.len() <= MAX_BATCH, "{} requests", calls.len());
            calls
        }
    };
    for refused in calls.into_iter().filter_map(Result::err) {
        assert!(serde_json::to_string(&refused).is_ok(), "{refused:?}");
    }
}
