//! Refused requests are written down, whoever refused them: the guard, the parser, or the gripper.

use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::Response;

use super::extract::Asker;
use super::{API, Context};
use crate::frontend::refusals::Refusal;
use crate::gripper::model::{Name, Text};

/// The most bytes of a path's end that are written down.
const MAX_COMMAND_BYTES: usize = 32;

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
    let (gripper, command) = asked_for(request.uri().path());
    let response = next.run(request).await;
    if let Some(Refused { code, cause }) = response.extensions().get().cloned() {
        context.refusals.take(Refusal { gripper, client, command, code }, cause);
    }
    response
}

/// The gripper that a path names, and its last part.
fn asked_for(path: &str) -> (Option<Name>, String) {
    let below = path.strip_prefix(API).and_then(|path| path.strip_prefix("/grippers/"));
    let gripper = below.and_then(|below| below.split('/').next()).and_then(|name| name.parse().ok());
    let last = path.rsplit('/').next().unwrap_or_default();
    (gripper, Text::<MAX_COMMAND_BYTES>::truncated(last).as_str().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_names_its_gripper_and_what_is_asked_of_it() {
        let (gripper, command) = asked_for("/api/v1/grippers/left/settings/acceleration");
        assert_eq!((gripper.unwrap().as_str(), command.as_str()), ("left", "acceleration"));
        assert_eq!(asked_for("/api/v1/fast-stop"), (None, "fast-stop".to_owned()));
        assert_eq!(asked_for(&format!("/{}", "x".repeat(100))).1.len(), MAX_COMMAND_BYTES);
    }
}
