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
use crate::gripper::model::Link;
use crate::gripper::{Handle, Recorder as _};
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

/// Readiness of the gateway.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "gateway": "wsg", "ready": false, "journal_cause": null, "journal_damage": null, "zenoh_cause": null,
    "not_ready": ["left: reconnecting: connection refused"]
}))]
pub struct Readiness {
    /// The gateway's name.
    #[schema(max_length = 32)]
    gateway: String,
    /// Whether every gripper is connected, the journal is writable and undamaged, and Zenoh is connected as configured.
    ready: bool,
    /// Why the journal can't be written; null while it can.
    #[schema(required)]
    journal_cause: Option<String>,
    /// Damage to earlier records of the journal, and the remedy; null if none was found. New records are still written,
    /// and motions continue.
    #[schema(required)]
    journal_damage: Option<String>,
    /// Why Zenoh is not connected as configured, or why motions over Zenoh are refused; null if all is well or Zenoh is
    /// off.
    #[schema(required)]
    zenoh_cause: Option<String>,
    /// Grippers that are not connected: name, link state and cause.
    not_ready: Vec<String>,
}

/// Check readiness
///
/// The gateway is ready when every gripper's link is connected, the journal is writable and undamaged, and Zenoh
/// listens and is connected at all configured endpoints. A latched FAST STOP does not affect readiness.
#[utoipa::path(
    get, path = "/readyz", operation_id = "readyz", tag = "gateway",
    responses(
        (status = 200, description = "The gateway is ready", body = Readiness),
        (status = 503, description = "The gateway is not ready", body = Readiness),
        AnyProblem,
    )
)]
pub async fn readiness(Shared(context): Shared<Arc<HttpContext>>) -> (StatusCode, Json<Readiness>) {
    let own = &context.gateway;
    let journal = own.journal.health().borrow().clone();
    let (journal_cause, journal_damage) = (journal.failure, journal.damage);
    let not_ready: Vec<_> = own.grippers.iter().filter_map(why_not_ready).collect();
    let zenoh_cause = own.peers.cause().borrow().clone().or_else(|| own.peers.why_no_motions());
    let ready = journal_cause.is_none() && journal_damage.is_none() && zenoh_cause.is_none() && not_ready.is_empty();
    let status = if ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let gateway = own.name.to_string();
    (status, Json(Readiness { gateway, ready, journal_cause, journal_damage, zenoh_cause, not_ready }))
}

fn why_not_ready(handle: &Handle) -> Option<String> {
    let state = handle.state();
    let cause = state.link_cause.as_ref().map(|cause| format!(": {cause}")).unwrap_or_default();
    (state.link != Link::Connected).then(|| format!("{}: {}{cause}", state.gripper, state.link))
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
