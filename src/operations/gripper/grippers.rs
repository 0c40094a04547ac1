//! The gateway's own knowledge of its grippers. None of these operations sends anything to a device.

use std::sync::Arc;

use serde::Serialize;
use utoipa::ToSchema;

use crate::gripper::{Handle, Info, Now};
use crate::model::{GripperStatus, State};
use crate::operations::calls::call::{Call, NoFields};
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::{Json, SharedJson};
use crate::operations::problem::Problem;
use crate::trends::Trend;

operations! {
    /// List all grippers
    LIST = GET "/grippers" as "grippers" {
        run: list, id: "list_grippers", tag: "grippers", problems: ANY,
        answer: "All grippers of this gateway",
    };

    /// Get a gripper
    ///
    /// Returns the gripper's device, limits, capabilities and link.
    INFO = GET "/grippers/{gripper}" as "info" {
        run: info, id: "get_gripper", tag: "grippers", problems: GRIPPER,
        answer: "The gripper",
    };

    /// Get a gripper's status
    ///
    /// Returns the bits and numbers that a cyclic program needs. The whole response is smaller than 256 bytes, because
    /// headers that only browsers need are left out.
    STATUS = GET "/grippers/{gripper}/status" as "status" {
        run: status, id: "get_status", tag: "grippers", problems: GRIPPER,
        answer: "The status",
    }.compact();

    /// Get a gripper's state
    ///
    /// Returns the newest state; `age_ms` is its age.
    STATE = GET "/grippers/{gripper}/state" as "state" {
        run: state, id: "get_state", tag: "grippers", problems: GRIPPER,
        answer: "The newest state",
    };

    /// Get a gripper's trend
    ///
    /// Returns the measured values of the last ten minutes, five a second at most, for charts.
    TREND = GET "/grippers/{gripper}/trend" as "trend" {
        run: trend, id: "get_trend", tag: "grippers", problems: GRIPPER,
        answer: "The trend",
    };
}

/// All grippers.
#[derive(Debug, Serialize, ToSchema)]
pub struct GripperList {
    /// The grippers, sorted by name.
    grippers: Vec<Arc<Info>>,
}

fn list(call: &Call<NoFields>) -> Result<Json<GripperList>, Problem> {
    let NoFields {} = call.fields()?;
    Ok(Json(GripperList { grippers: call.gateway.grippers.all().iter().map(Handle::info).collect() }))
}

fn info(call: &Call<NoFields>) -> Result<SharedJson<Info>, Problem> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    Ok(SharedJson(gripper.handle.info()))
}

fn status(call: &Call<NoFields>) -> Result<Json<GripperStatus>, Problem> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    Ok(Json(GripperStatus::of(&gripper.handle.state(), Now::read().instant)))
}

fn state(call: &Call<NoFields>) -> Result<SharedJson<State>, Problem> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    Ok(SharedJson(gripper.handle.state()))
}

fn trend(call: &Call<NoFields>) -> Result<Json<Trend>, Problem> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    Ok(Json(call.gateway.trends.of(gripper.handle.name())))
}
