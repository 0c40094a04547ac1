//! Request bodies: read within bounds before anything else is done, so that even a refused client gets to see its
//! answer; then parsed as JSON, whatever the Content-Type says.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body as Stream, Bytes};
use axum::extract::{MatchedPath, Request};
use axum::http::header::{CONNECTION, HeaderValue};
use axum::http::request::Parts;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use http_body_util::{BodyExt, LengthLimitError, Limited};
use tokio::time::timeout;

use super::audit::urgency;
use super::fast_stop::is_fast_stop;
use super::forward::forwarded_urgency;
use crate::gripper::model::Urgency;
use crate::interfaces::admission::{Class, ConnectionPermit, HeldBytes};
use crate::interfaces::pace::RequestPace;
use crate::operations::json::MAX_BODY_BYTES;
use crate::operations::{Code, Problem};

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
    route.is_some_and(|route| urgency(&parts.method, route) != Urgency::None)
        || forwarded_urgency(&parts.method, parts.uri.path()) != Urgency::None
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
