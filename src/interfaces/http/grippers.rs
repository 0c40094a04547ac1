//! What the gateway knows of its grippers: no request here costs a device anything.

use std::sync::Arc;

use axum::Json;
use axum::extract::State as Shared;
use serde::Serialize;
use utoipa::ToSchema;

use super::Context;
use super::errors::Problem;
use super::extract::{Gripper, GripperPath, LeaseHeader};
use super::responses::{AnyProblem, GripperProblem};
use crate::gripper::Info;
use crate::gripper::model::State;

/// All grippers.
#[derive(Debug, Serialize, ToSchema)]
pub struct Grippers {
    /// By name.
    #[schema(value_type = Vec<Info>)]
    grippers: Vec<Arc<Info>>,
}

/// All grippers
#[utoipa::path(
    get, path = "/grippers", operation_id = "list_grippers", tag = "grippers",
    responses((status = 200, description = "All grippers of this gateway", body = Grippers), AnyProblem)
)]
pub async fn list(Shared(context): Shared<Arc<Context>>) -> Json<Grippers> {
    Json(Grippers { grippers: context.fleet.iter().map(crate::gripper::Handle::info).collect() })
}

/// A gripper
///
/// Its device, limits, capabilities and link.
#[utoipa::path(
    get, path = "/grippers/{gripper}", operation_id = "get_gripper", tag = "grippers",
    params(GripperPath, LeaseHeader),
    responses((status = 200, description = "The gripper", body = Info), GripperProblem)
)]
pub async fn info(gripper: Gripper) -> Result<Json<Arc<Info>>, Problem> {
    Ok(Json(gripper.with_lease(None)?.handle.info()))
}

/// A gripper's state
///
/// The newest; `age_ms` says how old it is.
#[utoipa::path(
    get, path = "/grippers/{gripper}/state", operation_id = "get_state", tag = "grippers",
    params(GripperPath, LeaseHeader),
    responses((status = 200, description = "The newest state", body = State), GripperProblem)
)]
pub async fn state(gripper: Gripper) -> Result<Json<Arc<State>>, Problem> {
    Ok(Json(gripper.with_lease(None)?.handle.state()))
}
