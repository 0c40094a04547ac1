//! FAST STOP over HTTP.
//!
//! A FAST STOP happens whatever its body says and however long the body takes, since the body is only a reason. So the
//! body is read here, within [`REASON_TIME`]. A client that disconnects earlier still stops its gripper, because the connection has
//! spawned its request.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::HeaderName;
use axum::http::header::{CONTENT_LENGTH, TRANSFER_ENCODING};
use http_body_util::{BodyExt, Limited};
use tokio::time::timeout;

use super::body;
use crate::connections::admission::{Class, ConnectionPermit};
use crate::operations::parameters::json::MAX_BODY_BYTES;

/// Time that a FAST STOP waits for its reason. Header and body usually arrive in one packet or in two directly after
/// each other. If the body is late, stopping matters more than knowing why.
pub(in crate::interfaces::http) const REASON_TIME: Duration = Duration::from_millis(20);

/// Time to read the rest of a body while the FAST STOP is in progress: no longer than the FAST STOP takes.
const REST_TIME: Duration = crate::gripper::handle::FAST_STOP_WAIT;

/// Maximum number of header fields of a FAST STOP that is recognised before its connection is served. Browsers and proxies
/// send about 25.
const MAX_FIELDS: usize = 100;

/// The end of a FAST STOP's path.
const FAST_STOP: &str = "/fast-stop";

/// Stops with the body's reason, if it arrives in time. The rest of the body is read meanwhile, so that the client sees
/// the response.
///
/// With `permit`, the connection gets the slot of a FAST STOP once the body is complete. A FAST STOP whose body stays
/// unfinished must not take the slot, and so the answer, of a client that has sent a whole request.
pub async fn with_reason<T>(
    mut stream: Body,
    permit: Option<Arc<ConnectionPermit>>,
    stop: impl AsyncFnOnce(Bytes) -> T,
) -> T {
    let collected = timeout(REASON_TIME, Limited::new(&mut stream, MAX_BODY_BYTES).collect()).await;
    let (text, _claim) = match collected {
        Ok(Ok(collected)) => (collected.to_bytes(), permit.and_then(|permit| permit.claim(Class::Urgent))),
        _ => (Bytes::new(), None),
    };
    let (stopped, _) = tokio::join!(stop(text), timeout(REST_TIME, body::drain(stream)));
    stopped
}

/// Whether a connection begins with a whole FAST STOP: its head, and as many bytes of a body as the head announces.
pub fn begins_with_fast_stop(first: &[u8]) -> bool {
    let mut fields = [httparse::EMPTY_HEADER; MAX_FIELDS];
    let mut request = httparse::Request::new(&mut fields);
    let Ok(httparse::Status::Complete(head)) = request.parse(first) else { return false };
    let path = request.path.and_then(|target| target.split('?').next()).unwrap_or_default();
    let is_fast_stop = path.trim_end_matches('/').ends_with(FAST_STOP);
    // The end of a chunked body is not announced.
    if !is_fast_stop || field_value(request.headers, &TRANSFER_ENCODING).is_some() {
        return false;
    }
    let announced = field_value(request.headers, &CONTENT_LENGTH).unwrap_or(b"0");
    let announced = std::str::from_utf8(announced).ok().and_then(|length| length.trim().parse().ok());
    announced.is_some_and(|announced: usize| first.len() - head >= announced)
}

fn field_value<'a>(fields: &[httparse::Header<'a>], name: &HeaderName) -> Option<&'a [u8]> {
    let field = fields.iter().find(|field| field.name.eq_ignore_ascii_case(name.as_str()));
    field.map(|field| field.value)
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
        for target in ["/api/v1/fast-stop?source=curtain", "/api/v1/fast-stop/", "http://cell/api/v1/fast-stop?x=/"] {
            assert!(
                begins_with_fast_stop(format!("POST {target} HTTP/1.1\r\nhost: cell\r\n\r\n").as_bytes()),
                "{target}"
            );
        }
        assert!(!begins_with_fast_stop(b"POST /api/v1/grippers/g/stop HTTP/1.1\r\nHost: localhost\r\n\r\n/fast-stop"));
    }
}
