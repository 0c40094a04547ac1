//! Audit of requests that are refused before an operation runs, because of their host, origin, body or path.

use axum::extract::{MatchedPath, Request};
use axum::http::{Method as Verb, StatusCode};
use axum::response::Response;

use super::problem::RefusedMark;
use super::requested_operation::Asked;
use super::visitor::client;
use crate::connections::metrics::NO_ROUTE;
use crate::interfaces::http::context::{API, HttpContext};
use crate::model::Name;
use crate::operations::calls::audit::RefusedRequest;
use crate::operations::journal_command;

/// Records a request if it is refused. A refused read is recorded only if it lacks a valid credential.
pub async fn record(context: &HttpContext, request: Request, next: impl AsyncFnOnce(Request) -> Response) -> Response {
    let only_reads = matches!(*request.method(), Verb::GET | Verb::HEAD | Verb::OPTIONS);
    if only_reads && !context.gateway.access.is_guarded() {
        return next(request).await;
    }
    let client = client(request.extensions());
    let asked: Asked = request.extensions().get().copied().unwrap_or_default();
    let route = request.extensions().get::<MatchedPath>().cloned();
    // An invented gripper name is left out, because each name would be counted as another kind of refusal.
    let gripper = gripper(request.uri().path()).filter(|name| context.gateway.grippers.get(name).is_some());
    let response = next(request).await;
    if let Some(RefusedMark { code, cause, is_recorded: false }) = response.extensions().get().cloned()
        && (!only_reads || response.status() == StatusCode::UNAUTHORIZED)
    {
        let route = route.as_ref().map(MatchedPath::as_str);
        let command = route.map_or(NO_ROUTE, journal_command).to_owned();
        context.gateway.audit.record(RefusedRequest { gripper, client, command, code }, &cause, asked.urgency()).await;
    }
    response
}

fn gripper(path: &str) -> Option<Name> {
    let below = path.strip_prefix(API).and_then(|path| path.strip_prefix("/grippers/"));
    below.and_then(|below| below.split('/').next()).and_then(|name| name.parse().ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn path_names_its_gripper() {
        assert_eq!(gripper("/api/v1/grippers/left/settings/acceleration").unwrap().as_str(), "left");
        assert_eq!(gripper("/api/v1/fast-stop"), None);
    }
}
