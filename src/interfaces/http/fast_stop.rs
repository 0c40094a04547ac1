//! FAST STOP over HTTP.
//!
//! A FAST STOP happens whatever its body says and however long the body takes, since the body is only a reason. So the
//! body is read here, within [`REASON_TIME`]. A client that disconnects earlier still stops its gripper.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::Method;
use http_body_util::{BodyExt, Limited};
use tokio::time::timeout;
use tracing::Instrument as _;

use super::body;
use crate::interfaces::admission::{Class, ConnectionPermit};
use crate::operations::json::MAX_BODY_BYTES;
use crate::operations::{Code, Problem};

/// Time that a FAST STOP waits for its reason. Header and body usually arrive in one packet or in two directly after
/// each other. If the body is late, stopping matters more than knowing why.
pub(super) const REASON_TIME: Duration = Duration::from_millis(20);

/// Time to read the rest of a body while the FAST STOP is in progress: no longer than the FAST STOP takes.
const REST_TIME: Duration = crate::gripper::handle::FAST_STOP_WAIT;

const END_OF_HEAD: &[u8] = b"\r\n\r\n";

/// The end of a FAST STOP's path.
const FAST_STOP: &str = "/fast-stop";

/// Stops with the body's reason, if it arrives in time. The rest of the body is read meanwhile, so that the client sees
/// the response. Runs on its own task, since a handler ends with its client's connection.
///
/// With `permit`, the connection gets the slot of a FAST STOP once the body is complete. A FAST STOP whose body stays
/// unfinished must not take the slot, and so the answer, of a client that has sent a whole request.
pub async fn with_reason<T, S, F>(
    mut stream: Body,
    permit: Option<Arc<ConnectionPermit>>,
    stop: S,
) -> Result<T, Problem>
where
    T: Send + 'static,
    S: FnOnce(Bytes) -> F + Send + 'static,
    F: Future<Output = T> + Send,
{
    let stopping = async move {
        let collected = timeout(REASON_TIME, Limited::new(&mut stream, MAX_BODY_BYTES).collect()).await;
        let (text, _claim) = match collected {
            Ok(Ok(collected)) => (collected.to_bytes(), permit.and_then(|permit| permit.claim(Class::Urgent))),
            _ => (Bytes::new(), None),
        };
        let (stopped, _) = tokio::join!(stop(text), timeout(REST_TIME, body::drain(stream)));
        stopped
    };
    tokio::spawn(stopping.in_current_span())
        .await
        .map_err(|error| Problem::new(Code::Internal, format!("result of the FAST STOP unknown: {error}")))
}

/// Whether a request is a FAST STOP, judged by its path.
pub fn is_fast_stop<B>(request: &axum::http::Request<B>) -> bool {
    request.method() == Method::POST && request.uri().path().trim_end_matches('/').ends_with(FAST_STOP)
}

/// Whether a request stops fingers, judged by its path: a FAST STOP, a Stop or a cancel.
pub fn is_stop<B>(request: &axum::http::Request<B>) -> bool {
    let path = request.uri().path().trim_end_matches('/');
    is_fast_stop(request) || ["/stop", "/cancel"].iter().any(|end| path.ends_with(end))
}

/// Whether a connection begins with a whole FAST STOP: its head, and as many bytes of a body as the head announces.
pub fn begins_with_fast_stop(first: &[u8]) -> bool {
    let Some(head) = first.windows(END_OF_HEAD.len()).position(|part| part == END_OF_HEAD) else { return false };
    let (head, body) = first.split_at(head + END_OF_HEAD.len());
    if !may_be_fast_stop(head) {
        return false;
    }
    let fields = String::from_utf8_lossy(head).to_ascii_lowercase();
    let fields = fields.lines().filter_map(|line| line.split_once(':'));
    let mut announced = 0;
    for (name, value) in fields {
        match (name, value.trim().parse::<usize>()) {
            ("content-length", Ok(length)) => announced = length,
            // The end of such a body is not announced.
            ("content-length", Err(_)) | ("transfer-encoding", _) => return false,
            _ => {}
        }
    }
    body.len() >= announced
}

/// Whether a request that begins with these bytes can be a FAST STOP.
pub fn may_be_fast_stop(first: &[u8]) -> bool {
    let line = first.split(|byte| *byte == b'\n').next().unwrap_or_default();
    line.windows(FAST_STOP.len()).any(|part| part == FAST_STOP.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_whole_request_begins_with_a_fast_stop() {
        let post = "POST /api/v1/fast-stop HTTP/1.1\r\nHost: localhost\r\n";
        for (rest, expected) in [
            ("\r\n", true),
            ("Content-Length: 0\r\n\r\n", true),
            ("content-length:2\r\n\r\n{}", true),
            ("Content-Length: 2\r\n\r\n{", false),
            ("Content-Length: two\r\n\r\n{}", false),
            ("Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n", false),
            ("", false),
            ("Content-Length: 0\r\n", false),
        ] {
            assert_eq!(begins_with_fast_stop(format!("{post}{rest}").as_bytes()), expected, "{rest:?}");
        }
        assert!(!begins_with_fast_stop(b"POST /api/v1/grippers/g/stop HTTP/1.1\r\nHost: localhost\r\n\r\n/fast-stop"));
    }
}
