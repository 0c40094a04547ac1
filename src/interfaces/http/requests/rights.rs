//! Check of the right to read. Operations check their callers themselves.

use axum::extract::{MatchedPath, Request};
use axum::response::{IntoResponse, Response};

use super::body;
use super::forward;
use super::requested_operation::Asked;
use super::visitor::Identified;
use crate::access::Right;
use crate::interfaces::http::context::{API, HttpContext, SOCKET};
use crate::interfaces::http::documents::docs;
use crate::interfaces::http::resources::session::SESSION;
use crate::interfaces::http::resources::tickets;
use crate::operations::require;

/// Refuses a client without the right to read, wherever no operation checks its caller.
pub async fn check(context: &HttpContext, request: Request, next: impl AsyncFnOnce(Request) -> Response) -> Response {
    let route = request.extensions().get().map(MatchedPath::as_str);
    let asked: Asked = request.extensions().get().copied().unwrap_or_default();
    if asked.is_operation() || !route.is_some_and(needs_read) {
        return next(request).await;
    }
    let identified = Identified::client_of(&context.gateway.access, request.extensions());
    let allowed = identified.identity.map_err(Into::into);
    match allowed.and_then(|identity| require(&identity, Right::Read, None)) {
        Ok(()) => next(request).await,
        Err(problem) => {
            body::drain(request.into_body()).await;
            problem.into_response()
        }
    }
}

/// Whether a route without an operation needs the right to read. The files of the dashboard, the guides, the Python package
/// and the API's documents have nothing of the plant, so anyone can read them. Readiness decides by itself what it tells. Everything that is not named here needs
/// the right.
fn needs_read(route: &str) -> bool {
    let Some(path) = route.strip_prefix(API) else { return route == "/metrics" };
    let is_open = [SOCKET, tickets::PATH].contains(&path) || docs::DOCUMENTS.contains(&path);
    !forward::PATHS.contains(&path) && !is_open && !SESSION.contains(&path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn routes_that_no_operation_checks_need_the_right_to_read() {
        for route in ["/metrics", "/api/v1/events", "/api/v1/grips.csv", "/api/v1/stream", "/api/v1/new"] {
            assert!(needs_read(route), "{route}");
        }
        for route in ["/", "/healthz", "/readyz", "/docs", "/python/", "/api/v1/openapi.json", "/api/v1/session"] {
            assert!(!needs_read(route), "{route}");
        }
    }
}
