//! Paces a request, reads its body and claims its connection's slot.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Body as Stream;
use axum::extract::Request;
use axum::http::header::{CONNECTION, HeaderValue};
use axum::http::request::Parts;
use axum::response::{IntoResponse, Response};
use tokio::time::timeout;

use super::body::{HeldBody, check_announced, check_encoding, read};
use super::requested_operation::Asked;
use crate::connections::admission::{Class, ConnectionPermit};
use crate::connections::pace::RequestPace;
use crate::model::Urgency;
use crate::operations::{Code, Problem};

/// Time that a complete request waits for its turn. Requests take milliseconds, unless a device is slow.
const TURN_TIME: Duration = Duration::from_secs(2);

/// Reads the body before the handlers see the request. The connection claims its slot only after the body has arrived.
/// A FAST STOP waits for nothing, and its handler claims a slot once the body is complete. A Stop does not wait for its
/// body, which the handler reads.
pub async fn read_first(request: Request, next: impl AsyncFnOnce(Request) -> Response) -> Response {
    let permit: Option<Arc<ConnectionPermit>> = request.extensions().get().cloned();
    let pace: Option<Arc<RequestPace>> = request.extensions().get().cloned();
    let asked: Asked = request.extensions().get().copied().unwrap_or_default();
    if asked.urgency() == Urgency::FastStop {
        if let Some(pace) = pace {
            pace.next_fast_stop().await;
        }
        return next(request).await;
    }
    let (parts, stream) = request.into_parts();
    let is_urgent = asked.urgency() != Urgency::None;
    if let Some(pace) = pace {
        pace.next(is_urgent).await;
    }
    let (stream, _held) = if asked.ignores_mistakes() {
        (stream, None)
    } else {
        match read_body(&parts, stream, permit.as_ref()).await {
            Ok((bytes, held)) => (Stream::from(bytes), held),
            // The rest of the body must not be parsed as a request.
            Err(problem) => return ([(CONNECTION, HeaderValue::from_static("close"))], problem).into_response(),
        }
    };
    let _claim = match &permit {
        Some(permit) if is_urgent => permit.claim(Class::Answering).or_else(|| permit.claim(Class::Urgent)),
        Some(permit) => {
            let Ok(claim) = timeout(TURN_TIME, permit.turn(Class::Answering)).await else {
                let detail = "too many requests are in progress: try again later";
                return Problem::new(Code::Overloaded, detail).into_response();
            };
            Some(claim)
        }
        None => None,
    };
    next(Request::from_parts(parts, stream)).await
}

async fn read_body(parts: &Parts, stream: Stream, permit: Option<&Arc<ConnectionPermit>>) -> Result<HeldBody, Problem> {
    check_announced(&parts.headers)?;
    let (bytes, held) = read(stream, permit).await?;
    check_encoding(&parts.headers, &bytes)?;
    Ok((bytes, held))
}
