//! Large answers: pages of the journal, which are made for one client. Their bytes count as held for its connection until
//! the client has taken them, so that clients that ask for many and read none are disconnected.

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

use crate::interfaces::admission::ConnectionPermit;
use crate::operations::{Code, Problem};

/// Answers from this size on are counted. Smaller ones fit the buffers that every connection has.
const COUNTED_FROM: u64 = 16 * 1024;

/// Bytes of an answer that are handed over at once.
const PART_BYTES: usize = 16 * 1024;

/// Reads of the journal that may be under way: each holds up to a thousand records, which are counted only once the answer
/// is made.
pub const MAX_READS: usize = 8;

/// Time that a read waits for its place.
const PLACE_TIME: Duration = Duration::from_secs(2);

/// The middleware, with the places for reads.
pub async fn count(State(places): State<Arc<Semaphore>>, request: Request, next: Next) -> Response {
    let Ok(Ok(_place)) = timeout(PLACE_TIME, places.acquire()).await else {
        let detail = format!("{MAX_READS} requests read the journal already: try again when some have been answered");
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
