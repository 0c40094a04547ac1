//! Access log and request metrics.

use std::sync::Arc;
use std::time::Instant;

use axum::extract::{MatchedPath, Request};
use axum::http::Method;
use axum::response::Response;
use tracing::field::Empty;
use tracing::{Instrument, Span, debug, debug_span, info, info_span};

use super::problem::RefusedMark;
use super::refused_sockets::Handshake;
use super::visitor::client;
use crate::interfaces::http::context::{API, HttpContext, SOCKET};

/// Counts and logs a request: a read at DEBUG, any other at INFO.
pub async fn watch(context: &HttpContext, request: Request, next: impl AsyncFnOnce(Request) -> Response) -> Response {
    let method = request.method().clone();
    let span = span(&request);
    let route = request.extensions().get::<MatchedPath>().cloned();
    let is_socket = method == Method::GET && request.uri().path().strip_prefix(API) == Some(SOCKET);
    let handshake = is_socket.then(|| (client(request.extensions()), Handshake::of(request.headers())));
    let since = Instant::now();
    let response = next(request).instrument(span.clone()).await;
    let status = response.status().as_u16();
    let duration_ms = since.elapsed().as_millis() as u64;
    let refused: Option<&RefusedMark> = response.extensions().get();
    if let Some((client, headers)) = handshake
        && let Some(refused) = refused
    {
        context.refused_sockets.note(&client.subject, &headers, refused);
    }
    let code = refused.map(|RefusedMark { code, .. }| code.as_str());
    span.in_scope(|| match method {
        Method::GET | Method::HEAD => debug!(status, code, duration_ms, "answered"),
        _ => info!(status, code, duration_ms, "answered"),
    });
    context.metrics.answered(route.as_ref().map(MatchedPath::as_str), bounded(&method), status);
    response
}

/// Returns the span of a request. Most requests are reads: a span that no log shows costs them nothing.
fn span(request: &Request) -> Span {
    let method = request.method();
    let path = request.uri().path();
    match *method {
        Method::GET | Method::HEAD => debug_span!("request", %method, path, client = %subject(request)),
        _ => info_span!("request", %method, path, client = %subject(request), command = Empty, fast_stop = Empty),
    }
}

fn subject(request: &Request) -> Arc<str> {
    client(request.extensions()).subject
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
