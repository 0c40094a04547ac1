//! Check of the right to read. Operations check their callers themselves.

use axum::extract::{MatchedPath, Request};
use axum::http::Method as Verb;
use axum::response::{IntoResponse, Response};

use super::context::{API, HttpContext};
use super::forward;
use super::session::SESSION;
use super::visitor::Identified;
use super::{body, docs};
use crate::access::Right;
use crate::operations::{find, require};

/// Refuses a client without the right to read, wherever no operation checks its caller.
pub async fn check(context: &HttpContext, request: Request, next: impl AsyncFnOnce(Request) -> Response) -> Response {
    let route = request.extensions().get().map(MatchedPath::as_str);
    if !route.is_some_and(|route| needs_read(request.method(), route)) {
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

/// Whether a route needs the right to read. The dashboard's files, the guides and the API's documents have nothing of
/// the plant, so anyone can read them; everything that is not named here needs the right.
fn needs_read(verb: &Verb, route: &str) -> bool {
    let Some(path) = route.strip_prefix(API) else { return matches!(route, "/readyz" | "/metrics") };
    let verb = if verb == Verb::HEAD { &Verb::GET } else { verb };
    let is_checked = find(verb, path.trim_end_matches('/')).is_some() || forward::PATHS.contains(&path);
    !is_checked && !SESSION.contains(&path) && path != super::upgrade::PATH && !docs::DOCUMENTS.contains(&path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn routes_that_no_operation_checks_need_the_right_to_read() {
        let needs = |route: &str| needs_read(&Verb::GET, route);
        for route in ["/metrics", "/readyz", "/api/v1/events", "/api/v1/grips.csv", "/api/v1/stream", "/api/v1/new"] {
            assert!(needs(route), "{route}");
        }
        for route in ["/", "/healthz", "/docs", "/api/v1/openapi.json", "/api/v1/session", "/api/v1/grippers"] {
            assert!(!needs(route), "{route}");
        }
        assert!(!needs_read(&Verb::POST, "/api/v1/fast-stop/"));
        assert!(!needs_read(&Verb::HEAD, "/api/v1/grippers"));
    }
}
