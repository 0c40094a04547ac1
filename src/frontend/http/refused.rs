//! Refused requests are written down, whoever refused them: the guard, the parser, or the gripper. Who is refused all
//! too often hears of it later, but for what stops, and what keeps or ends a lease.

use std::sync::Arc;

use axum::extract::{MatchedPath, Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::Response;

use super::extract::Asker;
use super::{API, Context};
use crate::frontend::metrics::NO_ROUTE;
use crate::frontend::refusals::Refusal;
use crate::gripper::model::Name;

/// What a problem leaves at its response.
#[derive(Debug, Clone)]
pub struct Refused {
    /// The problem's code.
    pub code: String,
    /// Its words.
    pub cause: String,
}

/// The middleware. Who only reads, changes nothing, and leaves no trace.
pub async fn record(State(context): State<Arc<Context>>, request: Request, next: Next) -> Response {
    if matches!(*request.method(), Method::GET | Method::HEAD | Method::OPTIONS) {
        return next.run(request).await;
    }
    let client = Asker::of(request.extensions()).0;
    let route = request.extensions().get::<MatchedPath>().map(MatchedPath::as_str);
    let (gripper, command) = (gripper(request.uri().path()), command(route));
    let is_prompt = is_prompt(request.method(), &command);
    let response = next.run(request).await;
    if let Some(Refused { code, cause }) = response.extensions().get().cloned() {
        let held_back_for = context.refusals.take(Refusal { gripper, client, command, code }, cause);
        if let Some(time) = held_back_for.filter(|_| !is_prompt) {
            context.refusals.hold_back(time).await;
        }
    }
    response
}

/// The gripper that a path names.
fn gripper(path: &str) -> Option<Name> {
    let below = path.strip_prefix(API).and_then(|path| path.strip_prefix("/grippers/"));
    below.and_then(|below| below.split('/').next()).and_then(|name| name.parse().ok())
}

/// Whether nothing holds its answer back: what stops, and what keeps or ends a lease.
fn is_prompt(method: &Method, command: &str) -> bool {
    match command {
        "fast-stop" | "stop" | "cancel" => true,
        "lease" => matches!(*method, Method::PUT | Method::DELETE),
        _ => false,
    }
}

/// The last part of a route's template that is no parameter: paths are the clients', and there is no end of them.
fn command(route: Option<&str>) -> String {
    let last = route.and_then(|route| route.rsplit('/').find(|part| !part.starts_with('{')));
    last.unwrap_or(NO_ROUTE).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_names_its_gripper_and_its_route_what_is_asked_of_it() {
        let left = gripper("/api/v1/grippers/left/settings/acceleration");
        assert_eq!(left.unwrap().as_str(), "left");
        assert_eq!(gripper("/api/v1/fast-stop"), None);
        assert_eq!(command(Some("/api/v1/grippers/{g}/settings/acceleration")), "acceleration");
        assert_eq!(command(Some("/api/v1/grippers/{g}/custom/{id}")), "custom");
        assert_eq!(command(None), "none");
        for (method, route) in [(Method::POST, "stop"), (Method::PUT, "lease"), (Method::DELETE, "lease")] {
            assert!(is_prompt(&method, route), "{method} {route}");
        }
        assert!(!is_prompt(&Method::POST, "lease") && !is_prompt(&Method::POST, "move"));
    }
}
