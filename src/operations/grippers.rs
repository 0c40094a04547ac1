//! The gateway's own knowledge of its grippers. None of these operations sends anything to a device.

use std::sync::Arc;

use serde::Serialize;
use utoipa::ToSchema;

use super::call::{Call, NoFields};
use super::operation::{Operation, ready};
use super::problem::Problem;
use super::reply::Json;
use crate::gripper::model::{GripperStatus, State};
use crate::gripper::{Handle, Info, Now};
use crate::trends::Trend;

pub const LIST: Operation = Operation::read("grippers", "/grippers", |call| ready(list(&call)));
pub const INFO: Operation = Operation::read("info", "/grippers/{gripper}", |call| ready(info(&call)));
pub const STATUS: Operation =
    Operation::read("status", "/grippers/{gripper}/status", |call| ready(status(&call))).compact();
pub const STATE: Operation = Operation::read("state", "/grippers/{gripper}/state", |call| ready(state(&call)));

pub const TREND: Operation = Operation::read("trend", "/grippers/{gripper}/trend", |call| ready(trend(&call)));

/// All grippers.
#[derive(Debug, Serialize, ToSchema)]
pub struct GripperList {
    /// The grippers, sorted by name.
    #[schema(value_type = Vec<Info>)]
    grippers: Vec<Arc<Info>>,
}

fn list(call: &Call) -> Result<Json<GripperList>, Problem> {
    let NoFields {} = call.fields()?;
    Ok(Json(GripperList { grippers: call.gateway.grippers.all().iter().map(Handle::info).collect() }))
}

fn info(call: &Call) -> Result<Json<Arc<Info>>, Problem> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    Ok(Json(gripper.with_lease(None)?.handle.info()))
}

fn status(call: &Call) -> Result<Json<GripperStatus>, Problem> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    Ok(Json(GripperStatus::of(&gripper.with_lease(None)?.handle.state(), Now::read().instant)))
}

fn state(call: &Call) -> Result<Json<Arc<State>>, Problem> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    Ok(Json(gripper.with_lease(None)?.handle.state()))
}

fn trend(call: &Call) -> Result<Json<Trend>, Problem> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    Ok(Json(call.gateway.trends.of(gripper.with_lease(None)?.handle.name())))
}
