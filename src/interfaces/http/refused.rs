//! Refused requests are written down, whoever refused them: the guard, the parser, or the gripper. Who is refused all
//! too often hears of it later, but for what stops, and what keeps or ends a lease.

use std::sync::Arc;

use axum::extract::{MatchedPath, Request, State};
use axum::http::Method as Verb;
use axum::middleware::Next;
use axum::response::Response;

use super::extract::Asker;
use super::methods::{Method, urgency};
use super::{API, Context};
use crate::fleet::Urgency;
use crate::gripper::model::Name;
use crate::interfaces::metrics::NO_ROUTE;
use crate::interfaces::refusals::Refusal;

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
    if matches!(*request.method(), Verb::GET | Verb::HEAD | Verb::OPTIONS) {
        return next.run(request).await;
    }
    let client = Asker::of(request.extensions()).0;
    let (method, route) = (request.method().clone(), request.extensions().get::<MatchedPath>().cloned());
    let gripper = gripper(request.uri().path());
    let response = next.run(request).await;
    if let Some(Refused { code, cause }) = response.extensions().get().cloned() {
        let route = route.as_ref().map(MatchedPath::as_str);
        let refusal = Refusal { gripper, client, command: command(route), code };
        let held_back_for = context.refusals.take(refusal, cause);
        if let Some(time) = held_back_for.filter(|_| !route.is_some_and(|route| is_prompt(&method, route))) {
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

/// Whether a route stops, or keeps or ends a lease: its answer is never held back, and it is never refused for the sake of
/// other requests.
pub fn is_prompt(verb: &Verb, route: &str) -> bool {
    Method::of_route(verb, route).is_some_and(|method| urgency(method.name) != Urgency::None)
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
        let is_prompt = |verb, path: &str| is_prompt(&verb, &format!("{API}/{path}"));
        for (verb, what) in
            [(Verb::POST, "fast-stop"), (Verb::POST, "stop"), (Verb::PUT, "lease"), (Verb::DELETE, "lease")]
        {
            assert!(is_prompt(verb, &format!("grippers/{{gripper}}/{what}")), "{what}");
        }
        assert!(is_prompt(Verb::POST, "grippers/{gripper}/commands/{command}/cancel"));
        assert!(is_prompt(Verb::POST, "fast-stop") && is_prompt(Verb::POST, "fleet/fast-stop"));
        for what in ["lease", "move"] {
            assert!(!is_prompt(Verb::POST, &format!("grippers/{{gripper}}/{what}")), "{what}");
        }
    }
}
