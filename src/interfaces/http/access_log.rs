//! Access log and request metrics.

use std::sync::Arc;
use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::Response;
use tracing::field::Empty;
use tracing::{Instrument, debug, info, info_span};

use super::context::HttpContext;
use super::problem::RefusedMark;
use super::visitor::client;

/// Middleware that counts and logs requests: reads at DEBUG, all others at INFO.
pub async fn watch(State(context): State<Arc<HttpContext>>, request: Request, next: Next) -> Response {
    let method = request.method().clone();
    let route = request.extensions().get::<MatchedPath>().cloned();
    let client = client(request.extensions()).subject;
    let path = request.uri().path();
    let span = info_span!("request", %method, path, %client, command = Empty, fast_stop = Empty);
    let since = Instant::now();
    let response = next.run(request).instrument(span.clone()).await;
    let (status, duration_ms) = (response.status().as_u16(), since.elapsed().as_millis() as u64);
    let code = response.extensions().get().map(|RefusedMark { code, .. }| code.as_str());
    span.in_scope(|| match method {
        Method::GET | Method::HEAD => debug!(status, code, duration_ms, "answered"),
        _ => info!(status, code, duration_ms, "answered"),
    });
    context.metrics.answered(route.as_ref().map(MatchedPath::as_str), bounded(&method), status);
    response
}

/// Returns the metric label of a method. Clients can invent methods, so unknown ones share one label.
fn bounded(method: &Method) -> &str {
    match *method {
        Method::GET | Method::HEAD | Method::POST | Method::PUT | Method::DELETE | Method::OPTIONS | Method::PATCH => {
            method.as_str()
        }
        _ => "other",
    }
}
