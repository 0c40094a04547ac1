//! The router: paths, and the steps around each request.
//!
//! `access_log` counts and logs, `guard` refuses foreign hosts and origins, and `turn` reads bodies within bounds,
//! except for FAST STOP, which waits for nothing. `audit` records what is refused before an operation runs.
//!
//! These steps share one middleware, because axum clones everything inside a middleware for each request.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use axum::extract::{OriginalUri, Request, State};
use axum::http::Method as Verb;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::routing::any;
use axum::{Router, middleware};
use futures_util::FutureExt as _;
use serde_json::Value;
use tokio::sync::Semaphore;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::context::{API, HttpContext};
use super::documents::openapi_document::completed;
use super::documents::{docs, guide, paths, python};
use super::requests::unknown_path::unknown_path;
use super::requests::{access_log, audit, forward, guard, large_responses, request_admission, rights};
use super::resources::{fleet_lists, gateway, journal, recipes, session, stream, tickets, upgrade};
use crate::interfaces::dashboard;
use crate::operations::{Code, Problem};

pub fn router(context: &Arc<HttpContext>) -> Router {
    let (routes, _) = routes().split_for_parts();
    routes.layer(middleware::from_fn_with_state(context.clone(), around)).with_state(context.clone())
}

/// Runs the steps around a request, outermost first.
async fn around(State(context): State<Arc<HttpContext>>, request: Request, next: Next) -> Response {
    let settings = context.settings.get();
    access_log::watch(&context, request, async |request| {
        let response = audit::record(&context, request, async |request| {
            guard::check_host_and_origin(&settings, request, async |request| {
                guard::apply_cors(&settings, request, next, |request, next| admitted(&context, request, next)).await
            })
            .await
        });
        guard::harden(response.await)
    })
    .await
}

/// Runs the steps that only an admitted request reaches.
async fn admitted(context: &HttpContext, request: Request, next: Next) -> Response {
    rights::check(context, request, async |request| {
        let method = request.method().clone();
        let uri = request.uri().clone();
        let served = request_admission::read_first(request, async |request| next.run(request).await);
        AssertUnwindSafe(served).catch_unwind().await.unwrap_or_else(|_| panicked(&method, uri.path()))
    })
    .await
}

/// Makes the OpenAPI document anew. [`OPENAPI`](super::OPENAPI) is the checked-in one.
#[must_use]
pub fn openapi() -> Value {
    completed(&routes().into_openapi())
}

type Routes = OpenApiRouter<Arc<HttpContext>>;

fn routes() -> Routes {
    let (router, mut document) = OpenApiRouter::with_openapi(docs::base())
        .nest(API, api())
        .routes(routes!(gateway::health))
        .routes(routes!(gateway::readiness))
        .routes(routes!(gateway::metrics))
        .fallback(not_found)
        .split_for_parts();
    docs::without_null_bodies(&mut document);
    let router = router
        .merge(docs::page())
        .merge(guide::pages())
        .merge(python::files())
        .merge(dashboard::page())
        .method_not_allowed_fallback(method_not_allowed);
    let mut all = OpenApiRouter::from(router);
    *all.get_openapi_mut() = document;
    all
}

fn journal() -> Routes {
    OpenApiRouter::new()
        .routes(routes!(journal::events))
        .routes(routes!(journal::events_csv))
        .routes(routes!(journal::grips))
        .routes(routes!(journal::grips_csv))
        .routes(routes!(journal::grip))
        .routes(routes!(journal::curve))
        .routes(routes!(journal::curve_csv))
        .routes(routes!(fleet_lists::events))
        .routes(routes!(fleet_lists::grips))
        .routes(routes!(fleet_lists::readiness))
        .layer(middleware::from_fn_with_state(
            Arc::new(Semaphore::new(large_responses::MAX_READS)),
            large_responses::count,
        ))
}

fn documents() -> Routes {
    OpenApiRouter::new().routes(routes!(docs::openapi)).routes(routes!(docs::asyncapi))
}

fn api() -> Routes {
    OpenApiRouter::from(paths::routes())
        .merge(documents())
        .merge(journal())
        .routes(routes!(stream::stream))
        .routes(routes!(upgrade::open))
        .routes(routes!(recipes::get_csv, recipes::set_csv))
        .routes(routes!(session::sign_in, session::sign_out))
        .routes(routes!(session::enter_pin, session::forget_pin))
        .routes(routes!(tickets::issue))
        .route(forward::PATHS[0], any(forward::forward))
        .route(forward::PATHS[1], any(forward::forward))
}

async fn not_found(OriginalUri(uri): OriginalUri) -> Problem {
    unknown_path(uri.path())
}

async fn method_not_allowed(method: Verb) -> Problem {
    Problem::new(Code::MethodNotAllowed, format!("method {method} is not allowed here; see the Allow header"))
}

/// Answers a request whose handler panicked, so that a bug ends one request and not the gateway.
fn panicked(method: &Verb, path: &str) -> Response {
    tracing::error!(%method, path, "a request handler panicked");
    Problem::internal().into_response()
}
