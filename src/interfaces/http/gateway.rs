//! The gateway's health, readiness and metrics.

use std::sync::Arc;

use axum::Json;
use axum::extract::State as Shared;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use prometheus::{TEXT_FORMAT, TextEncoder};
use serde::Serialize;
use utoipa::ToSchema;

use super::context::HttpContext;
use super::paths::responses::AnyProblem;
use crate::operations::readiness::Readiness;
use crate::operations::{Code, Problem};

/// Liveness of the gateway.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gateway": "wsg", "status": "ok"}))]
pub struct Health {
    /// The gateway's name.
    #[schema(max_length = 32)]
    gateway: String,
    /// Always `ok`.
    status: &'static str,
}

/// Check liveness
///
/// Succeeds whenever the gateway answers, whatever the state of its grippers.
#[utoipa::path(
    get, path = "/healthz", operation_id = "healthz", tag = "gateway",
    responses((status = 200, description = "The gateway answers", body = Health), AnyProblem)
)]
pub async fn health(Shared(context): Shared<Arc<HttpContext>>) -> Json<Health> {
    Json(Health { gateway: context.gateway.name.to_string(), status: "ok" })
}

/// Check readiness
///
/// The gateway is ready when every gripper's link is connected or released, the journal is writable and undamaged, and
/// Zenoh listens and is connected at all configured endpoints. A latched FAST STOP does not affect readiness.
#[utoipa::path(
    get, path = "/readyz", operation_id = "readyz", tag = "gateway",
    responses(
        (status = 200, description = "The gateway is ready", body = Readiness),
        (status = 503, description = "The gateway is not ready", body = Readiness),
        AnyProblem,
    )
)]
pub async fn readiness(Shared(context): Shared<Arc<HttpContext>>) -> (StatusCode, Json<Readiness>) {
    let readiness = Readiness::of(&context.gateway);
    let status = if readiness.ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    (status, Json(readiness))
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
