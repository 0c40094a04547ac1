//! Request bodies: read within bounds before anything else is done, so that even a refused client gets to see its
//! answer; then parsed as JSON, whatever the Content-Type says.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body as Stream, Bytes};
use axum::extract::{FromRequest, MatchedPath, Request};
use axum::http::header::{CONNECTION, HeaderValue};
use axum::http::request::Parts;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use http_body_util::{BodyExt, LengthLimitError, Limited};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use tokio::time::timeout;
use utoipa::ToSchema;

use super::errors::{Code, Problem};
use super::fleet::forwards_urgent;
use super::pace::RequestPace;
use super::refused::is_prompt;
use super::server::is_fast_stop;
use crate::interfaces::admission::{Class, ConnectionPermit, HeldBytes};

/// The largest body that is taken. The largest that any request needs is a `raw` one of 8 KiB.
pub const MAX_BODY_BYTES: usize = 64 * 1024;

/// How much of a larger body is read all the same, and thrown away. A client that is still sending when the
/// connection closes sees a reset, and never the answer that says why.
pub const MAX_DISCARDED_BYTES: usize = 2 * 1024 * 1024;

/// How long a body may take: [`MAX_BODY_BYTES`] at 64 kbit/s, and a little more.
pub const BODY_TIME: Duration = Duration::from_secs(10);

/// How long a complete request waits for its turn: a request is answered within milliseconds, unless a device is slow.
const TURN_TIME: Duration = Duration::from_secs(2);

/// The middleware that reads the body before the handlers see the request. Only then has the connection a claim on its
/// slot. A FAST STOP waits for nothing, and has one at once.
pub async fn read_first(request: Request, next: Next) -> Response {
    let permit: Option<Arc<ConnectionPermit>> = request.extensions().get().cloned();
    let pace: Option<Arc<RequestPace>> = request.extensions().get().cloned();
    if is_fast_stop(&request) {
        if let Some(pace) = pace {
            pace.next_fast_stop().await;
        }
        let _claim = permit.as_ref().and_then(|permit| permit.claim(Class::Urgent));
        return next.run(request).await;
    }
    let (parts, stream) = request.into_parts();
    let is_urgent = is_urgent(&parts);
    if let Some(pace) = pace {
        pace.next(is_urgent).await;
    }
    let (bytes, _held) = match read(stream, permit.as_ref()).await {
        Ok(read) => read,
        // The rest of the body must not be parsed as a request.
        Err(problem) => return ([(CONNECTION, HeaderValue::from_static("close"))], problem).into_response(),
    };
    let _claim = match &permit {
        Some(permit) if is_urgent => permit.claim(Class::Answering).or_else(|| permit.claim(Class::Urgent)),
        Some(permit) => {
            let Ok(claim) = timeout(TURN_TIME, permit.turn(Class::Answering)).await else {
                let detail = "too many requests are being answered: try again later";
                return Problem::new(Code::Overloaded, detail).into_response();
            };
            Some(claim)
        }
        None => None,
    };
    next.run(Request::from_parts(parts, Stream::from(bytes))).await
}

/// Whether a request only stops, or keeps or ends a lease, on a gripper of any gateway. Such a request is never refused
/// for the sake of others.
fn is_urgent(parts: &Parts) -> bool {
    let route = parts.extensions.get().map(MatchedPath::as_str);
    route.is_some_and(|route| is_prompt(&parts.method, route)) || forwards_urgent(&parts.method, parts.uri.path())
}

/// A body, and the count of its bytes as held for its connection.
type Held = (Bytes, Option<HeldBytes>);

/// Reads a body, within the bounds above.
async fn read(stream: Stream, permit: Option<&Arc<ConnectionPermit>>) -> Result<Held, Problem> {
    let too_late = || Problem::new(Code::RequestTimeout, format!("the body did not arrive within {BODY_TIME:?}"));
    timeout(BODY_TIME, collect(stream, permit)).await.map_err(|_| too_late())?
}

async fn collect(mut stream: Stream, permit: Option<&Arc<ConnectionPermit>>) -> Result<Held, Problem> {
    let mut held = permit.map(ConnectionPermit::held);
    let mut read = 0;
    let counted = (&mut stream).map_frame(|frame| {
        read += frame.data_ref().map_or(0, Bytes::len);
        if let Some(held) = &mut held {
            held.set(read);
        }
        frame
    });
    match Limited::new(counted, MAX_BODY_BYTES).collect().await {
        Ok(collected) => Ok((collected.to_bytes(), held)),
        Err(error) if error.is::<LengthLimitError>() => {
            drain(stream).await;
            let detail = format!("the body is larger than {MAX_BODY_BYTES} bytes");
            Err(Problem::new(Code::TooLarge, detail).limits(None, Some(MAX_BODY_BYTES.into())))
        }
        Err(error) => Err(Problem::new(Code::Malformed, format!("the body could not be read: {error}"))),
    }
}

/// The bytes of a body that was read before, or that is read now.
pub async fn bytes(stream: Stream) -> Result<Bytes, Problem> {
    read(stream, None).await.map(|(bytes, _)| bytes)
}

/// Reads what is left of a body, within the bounds above, and throws it away.
pub async fn drain(mut stream: Stream) {
    let read = async {
        let mut bytes = 0;
        while let Some(Ok(frame)) = stream.frame().await {
            bytes += frame.data_ref().map_or(0, Bytes::len);
            if bytes > MAX_DISCARDED_BYTES {
                break;
            }
        }
    };
    // Out of time or not, the answer is the same.
    let _ = timeout(BODY_TIME, read).await;
}

/// A body, parsed. Nothing at all is `{}`.
#[derive(Debug)]
pub struct Body<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Body<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, _: &S) -> Result<Self, Problem> {
        parse(&bytes(request.into_body()).await?).map(Self)
    }
}

/// A body that says nothing but whose it is.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({}))]
pub struct Leased {
    /// The lease's token of at most 64 bytes, while somebody holds one; empty is none.
    #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    pub lease: Option<String>,
}

/// The object in `bytes`.
pub fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    let bytes = match bytes.trim_ascii_start() {
        [] => b"{}",
        // A struct could be read from an array too, by position: nobody means that.
        object @ [b'{', ..] => object,
        _ => return Err(Problem::new(Code::Malformed, "the body must be a JSON object")),
    };
    let mut json = serde_json::Deserializer::from_slice(bytes);
    let parsed = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        let path = error.path().to_string();
        let detail = error.into_inner().to_string();
        match field(&path, &detail) {
            Some(field) => {
                let value = serde_json::from_slice::<Value>(bytes).ok().and_then(|body| body.get(&field).cloned());
                Problem::malformed(&field, format!("{field}: {detail}")).value(value)
            }
            None => Problem::new(Code::Malformed, format!("the body is no JSON that is understood: {detail}")),
        }
    })?;
    json.end().map_err(|error| Problem::new(Code::Malformed, format!("the body goes on after its end: {error}")))?;
    Ok(parsed)
}

/// The field that an error is about. The parser's path has none where the name itself is the mistake, whose words do, and a `?` where the JSON breaks off.
fn field(path: &str, detail: &str) -> Option<String> {
    let named = ["missing field `", "unknown field `", "duplicate field `"]
        .iter()
        .find_map(|start| detail.strip_prefix(start)?.split_once('`'))
        .map(|(field, _)| field);
    named
        .or((!matches!(path, "." | "?") && !path.ends_with(".?")).then_some(path))
        .map(|field| field.chars().take(MAX_FIELD_CHARS).collect())
}

/// How much of an unknown field's name is repeated to its sender.
const MAX_FIELD_CHARS: usize = 32;

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Move {
        width_mm: f64,
        #[serde(default)]
        relative: bool,
    }

    fn problem(body: &[u8]) -> Value {
        let problem = parse::<Move>(body).unwrap_err();
        serde_json::to_value(problem.members()).unwrap()
    }

    #[test]
    fn an_object_is_read() {
        assert_eq!(parse::<Move>(br#" {"width_mm": 96.0} "#).unwrap(), Move { width_mm: 96.0, relative: false });
        assert_eq!(
            parse::<Move>(br#"{"width_mm":96,"relative":true}"#).unwrap(),
            Move { width_mm: 96.0, relative: true }
        );
    }

    #[test]
    fn nothing_is_an_empty_object() {
        #[derive(Deserialize)]
        struct Nothing {}
        for nothing in [&b""[..], b" \r\n", b"{}"] {
            let Nothing {} = parse(nothing).unwrap();
        }
        assert_eq!(problem(b"")["field"], "width_mm");
    }

    #[test]
    fn the_field_that_is_wrong_is_named() {
        let wrong_type = problem(br#"{"width_mm": "20"}"#);
        assert_eq!((&wrong_type["code"], &wrong_type["field"]), (&"malformed".into(), &"width_mm".into()));
        assert_eq!(wrong_type["value"], "20");
        assert_eq!(problem(br#"{"width_mm": 20, "relative": 1}"#)["field"], "relative");
        assert_eq!(problem(br#"{"relative": true}"#)["field"], "width_mm");
        assert_eq!(problem(br#"{"widht_mm": 20}"#)["field"], "widht_mm");
        assert_eq!(problem(br#"{"width_mm": 20, "width_mm": 30}"#)["field"], "width_mm");
    }

    #[test]
    fn json_that_breaks_off_names_no_field() {
        for body in [&br#"{"width_mm": 20"#[..], b"{", b"{\"width_mm\": 20,, \"relative\": true}"] {
            assert_eq!(problem(body)["field"], Value::Null, "{}", String::from_utf8_lossy(body));
        }
    }

    #[test]
    fn what_is_no_object_is_malformed() {
        let bodies: [&[u8]; 10] = [
            b"[20, true]",
            b"20",
            b"null",
            b"\"x\"",
            b"{\"width_mm\": NaN}",
            b"{\"width_mm\": 1e999}",
            b"{\"width_mm\": 20} {}",
            b"{\"width_mm\": 20",
            b"{\"width_mm\": \"\xFF\"}",
            b"width_mm=20",
        ];
        for body in bodies {
            assert_eq!(problem(body)["code"], "malformed", "{}", String::from_utf8_lossy(body));
        }
    }

    #[test]
    fn a_long_value_is_not_repeated() {
        let body = format!("{{\"width_mm\": \"{}\"}}", "x".repeat(1000));
        let problem = problem(body.as_bytes());
        assert_eq!((problem["field"].as_str(), problem.get("value")), (Some("width_mm"), None));
    }
}
