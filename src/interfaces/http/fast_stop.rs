//! FAST STOP over HTTP.
//!
//! A FAST STOP happens whatever its body says and however long the body takes, since the body is only a reason. So the
//! body is read here, within [`REASON_TIME`]. A client that disconnects earlier still stops its gripper.

use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::Method;
use http_body_util::{BodyExt, Limited};
use tokio::time::timeout;
use tracing::Instrument as _;

use super::body;
use crate::operations::json::MAX_BODY_BYTES;
use crate::operations::{Code, Problem};

/// Time that a FAST STOP waits for its reason. Header and body usually arrive in one packet or in two directly after
/// each other. If the body is late, stopping matters more than knowing why.
pub(super) const REASON_TIME: Duration = Duration::from_millis(20);

/// Time to read the rest of a body while the FAST STOP is in progress: no longer than the FAST STOP takes.
const REST_TIME: Duration = crate::gripper::handle::FAST_STOP_WAIT;

/// The end of a FAST STOP's path.
const FAST_STOP: &str = "/fast-stop";

/// Stops with the body's reason, if it arrives in time. The rest of the body is read meanwhile, so that the client sees
/// the response. Runs on its own task, since a handler ends with its client's connection.
pub async fn with_reason<T, S, F>(mut stream: Body, stop: S) -> Result<T, Problem>
where
    T: Send + 'static,
    S: FnOnce(Bytes) -> F + Send + 'static,
    F: Future<Output = T> + Send,
{
    let stopping = async move {
        let text = match timeout(REASON_TIME, Limited::new(&mut stream, MAX_BODY_BYTES).collect()).await {
            Ok(Ok(collected)) => collected.to_bytes(),
            _ => Bytes::new(),
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

/// Whether a request that begins with these bytes can be a FAST STOP.
pub fn may_be_fast_stop(first: &[u8]) -> bool {
    let line = first.split(|byte| *byte == b'\n').next().unwrap_or_default();
    line.windows(FAST_STOP.len()).any(|part| part == FAST_STOP.as_bytes())
}
