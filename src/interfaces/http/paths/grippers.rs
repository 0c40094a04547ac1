//! Paths that list and describe the gateway's grippers.

use super::parameters::{GripperPath, LeaseHeader};
use super::paths;
use super::responses::{AnyProblem, GripperProblem};
use crate::gripper::Info;
use crate::gripper::model::{GripperStatus, State};
use crate::operations::grippers::{self, GripperList};
use crate::trends::Trend;

paths! {
    /// List all grippers
    #[utoipa::path(
        get, path = "/grippers", operation_id = "list_grippers", tag = "grippers",
        responses((status = 200, description = "All grippers of this gateway", body = GripperList), AnyProblem)
    )]
    list => grippers::LIST;
    /// Get a gripper
    ///
    /// Returns the gripper's device, limits, capabilities and link.
    #[utoipa::path(
        get, path = "/grippers/{gripper}", operation_id = "get_gripper", tag = "grippers",
        params(GripperPath, LeaseHeader),
        responses((status = 200, description = "The gripper", body = Info), GripperProblem)
    )]
    info => grippers::INFO;
    /// Get a gripper's state
    ///
    /// Returns the newest state; `age_ms` is its age.
    #[utoipa::path(
        get, path = "/grippers/{gripper}/state", operation_id = "get_state", tag = "grippers",
        params(GripperPath, LeaseHeader),
        responses((status = 200, description = "The newest state", body = State), GripperProblem)
    )]
    state => grippers::STATE;
    /// Get a gripper's status
    ///
    /// Returns the bits and numbers that a cyclic program needs. The whole response is smaller than 256 bytes, because
    /// headers that only browsers need are left out.
    #[utoipa::path(
        get, path = "/grippers/{gripper}/status", operation_id = "get_status", tag = "grippers",
        params(GripperPath, LeaseHeader),
        responses((status = 200, description = "The status", body = GripperStatus), GripperProblem)
    )]
    status => grippers::STATUS;
    /// Get a gripper's trend
    ///
    /// Returns the measured values of the last ten minutes, five a second at most, for charts.
    #[utoipa::path(
        get, path = "/grippers/{gripper}/trend", operation_id = "get_trend", tag = "grippers",
        params(GripperPath, LeaseHeader),
        responses((status = 200, description = "The trend", body = Trend), GripperProblem)
    )]
    trend => grippers::TREND;
}
