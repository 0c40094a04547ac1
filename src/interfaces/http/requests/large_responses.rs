//! Large responses: pages of the journal, each made for one client. Their bytes count as held for its connection until
//! the client has received them, so that clients that request many pages and read none are disconnected.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody as _};
use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use futures_util::stream::unfold;
use http_body_util::BodyExt as _;
use tokio::sync::Semaphore;
use tokio::time::timeout;

use crate::connections::admission::ConnectionPermit;
use crate::operations::{Code, Problem};

/// Size from which a response is counted. Smaller ones fit the buffers that every connection has.
const COUNTED_FROM: u64 = 16 * 1024;

/// Bytes of a response that are passed to the connection at once.
const PART_BYTES: usize = 16 * 1024;

/// Maximum number of concurrent journal reads. Each holds up to a thousand records, which are counted only once the
/// response is complete.
pub const MAX_READS: usize = 8;

/// Time that a read waits for a free slot.
const PLACE_TIME: Duration = Duration::from_secs(2);

/// Middleware that bounds concurrent reads and counts the bytes of their responses.
pub async fn count(State(places): State<Arc<Semaphore>>, request: Request, next: Next) -> Response {
    let Ok(Ok(_place)) = timeout(PLACE_TIME, places.acquire()).await else {
        let detail = format!("too many journal reads ({MAX_READS} in progress): try again later");
        return Problem::new(Code::Overloaded, detail).into_response();
    };
    let permit: Option<Arc<ConnectionPermit>> = request.extensions().get().cloned();
    let is_head = *request.method() == Method::HEAD;
    let response = next.run(request).await;
    let size = response.body().size_hint().exact().filter(|size| *size >= COUNTED_FROM && !is_head);
    let (Some(permit), Some(size)) = (permit, size) else { return response };
    let (mut parts, body) = response.into_parts();
    parts.headers.insert(header::CONTENT_LENGTH, HeaderValue::from(size));
    // The body is in memory already.
    let bytes = body.collect().await.map(http_body_util::Collected::to_bytes).unwrap_or_default();
    let mut held = permit.held();
    held.set(bytes.len());
    let stream = unfold((bytes, held), |(mut rest, held)| async move {
        let part: Bytes = rest.split_to(rest.len().min(PART_BYTES));
        (!part.is_empty()).then_some((Ok::<_, Infallible>(part), (rest, held)))
    });
    Response::from_parts(parts, Body::from_stream(stream))
}
