//! The gateway's health, readiness and metrics.

use std::sync::Arc;

use axum::Json;
use axum::extract::State as Shared;
use axum::http::{Extensions, StatusCode, header};
use axum::response::{IntoResponse, Response};
use prometheus::{TEXT_FORMAT, TextEncoder};
use serde::Serialize;
use utoipa::ToSchema;

use crate::access::{FastStopPolicy, Right, Unauthorized};
use crate::interfaces::http::context::HttpContext;
use crate::interfaces::http::documents::paths::responses::AnyProblem;
use crate::interfaces::http::requests::visitor::Identified;
use crate::operations::readiness::Readiness;
use crate::operations::{Code, Problem, require};

/// Liveness of the gateway.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gateway": "wsg", "status": "ok", "fast_stop": "anyone"}))]
pub struct Health {
    /// The gateway's name.
    #[schema(max_length = 32)]
    gateway: String,
    /// Always `ok`.
    status: &'static str,
    /// What a FAST STOP needs.
    fast_stop: FastStopPolicy,
}

/// Check liveness
///
/// Succeeds whenever the gateway answers, whatever the state of its grippers.
#[utoipa::path(
    get, path = "/healthz", operation_id = "healthz", tag = "gateway",
    responses((status = 200, description = "The gateway answers", body = Health), AnyProblem)
)]
pub async fn health(Shared(context): Shared<Arc<HttpContext>>) -> Json<Health> {
    let fast_stop = context.gateway.access.fast_stop();
    Json(Health { gateway: context.gateway.name.to_string(), status: "ok", fast_stop })
}

/// Check readiness
///
/// The gateway is ready when every gripper's link is connected or released, the journal is writable and undamaged, and
/// Zenoh listens and is connected at all configured endpoints. A latched FAST STOP does not affect readiness. A client
/// without a credential, such as a load balancer, gets the status and a text instead of the causes.
#[utoipa::path(
    get, path = "/readyz", operation_id = "readyz", tag = "gateway",
    responses(
        (
            status = 200, description = "The gateway is ready",
            content((Readiness = "application/json"), (String = "text/plain")),
        ),
        (
            status = 503, description = "The gateway is not ready",
            content((Readiness = "application/json"), (String = "text/plain")),
        ),
        AnyProblem,
    )
)]
pub async fn readiness(Shared(context): Shared<Arc<HttpContext>>, extensions: Extensions) -> Result<Response, Problem> {
    let readiness = Readiness::of(&context.gateway);
    let status = if readiness.ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let text = if readiness.ready { "ready\n" } else { "not ready\n" };
    match Identified::client_of(&context.gateway.access, &extensions).identity {
        Ok(identity) if require(&identity, Right::Read, None).is_ok() => Ok((status, Json(readiness)).into_response()),
        Ok(_) | Err(Unauthorized::Missing) => Ok((status, text).into_response()),
        Err(unknown) => Err(unknown.into()),
    }
}

/// Get metrics
///
/// Returns all metrics in the Prometheus text format.
#[utoipa::path(
    get, path = "/metrics", operation_id = "metrics", tag = "gateway",
    responses((status = 200, description = "The metrics", body = String, content_type = "text/plain"), AnyProblem)
)]
pub async fn metrics(Shared(context): Shared<Arc<HttpContext>>) -> Result<Response, Problem> {
    let text = TextEncoder::new().encode_to_string(&context.registry.gather());
    let text = text.map_err(|error| Problem::new(Code::Internal, format!("metrics could not be encoded: {error}")))?;
    Ok(([(header::CONTENT_TYPE, TEXT_FORMAT)], text).into_response())
}
