//! Audit of requests that are refused before an operation runs, because of their host, origin, body or path.

use axum::extract::{MatchedPath, Request};
use axum::http::{Method as Verb, StatusCode};
use axum::response::Response;

use super::context::{API, HttpContext};
use super::problem::RefusedMark;
use super::visitor::client;
use crate::gripper::model::{Name, Urgency};
use crate::interfaces::metrics::NO_ROUTE;
use crate::operations::audit::RefusedRequest;
use crate::operations::{find, journal_command};

/// Records a request if it is refused. A refused read is recorded only if it lacks a valid credential.
pub async fn record(context: &HttpContext, request: Request, next: impl AsyncFnOnce(Request) -> Response) -> Response {
    let only_reads = matches!(*request.method(), Verb::GET | Verb::HEAD | Verb::OPTIONS);
    if only_reads && !context.gateway.access.is_guarded() {
        return next(request).await;
    }
    let client = client(request.extensions());
    let (method, route) = (request.method().clone(), request.extensions().get::<MatchedPath>().cloned());
    // An invented gripper name is left out, because each name would be counted as another kind of refusal.
    let gripper = gripper(request.uri().path()).filter(|name| context.gateway.grippers.get(name).is_some());
    let response = next(request).await;
    if let Some(RefusedMark { code, cause, is_recorded: false }) = response.extensions().get().cloned()
        && (!only_reads || response.status() == StatusCode::UNAUTHORIZED)
    {
        let route = route.as_ref().map(MatchedPath::as_str);
        let command = route.map_or(NO_ROUTE, journal_command).to_owned();
        let urgency = route.map_or(Urgency::None, |route| urgency(&method, route));
        context.gateway.audit.record(RefusedRequest { gripper, client, command, code }, &cause, urgency).await;
    }
    response
}

fn gripper(path: &str) -> Option<Name> {
    let below = path.strip_prefix(API).and_then(|path| path.strip_prefix("/grippers/"));
    below.and_then(|below| below.split('/').next()).and_then(|name| name.parse().ok())
}

pub fn urgency(verb: &Verb, route: &str) -> Urgency {
    let operation = route.strip_prefix(API).and_then(|path| find(verb, path));
    operation.map_or(Urgency::None, |operation| operation.urgency)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn path_names_its_gripper() {
        assert_eq!(gripper("/api/v1/grippers/left/settings/acceleration").unwrap().as_str(), "left");
        assert_eq!(gripper("/api/v1/fast-stop"), None);
    }

    #[test]
    fn urgent_routes_are_known() {
        let of = |verb, path: &str| urgency(&verb, &format!("{API}/{path}"));
        assert_eq!(of(Verb::POST, "grippers/{gripper}/fast-stop"), Urgency::FastStop);
        assert_eq!(of(Verb::POST, "grippers/{gripper}/stop"), Urgency::Stop);
        assert_eq!(of(Verb::POST, "grippers/{gripper}/commands/{command}/cancel"), Urgency::Stop);
        assert_eq!(of(Verb::PUT, "grippers/{gripper}/lease"), Urgency::Lease);
        assert_eq!(of(Verb::DELETE, "grippers/{gripper}/lease"), Urgency::Lease);
        for what in ["lease", "move"] {
            assert_eq!(of(Verb::POST, &format!("grippers/{{gripper}}/{what}")), Urgency::None, "{what}");
        }
    }
}
