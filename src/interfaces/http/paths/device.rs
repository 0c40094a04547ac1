//! Paths of the remaining device commands: statistics, tare, Loop.

use super::parameters::{GripperPath, LeaseHeader};
use super::paths;
use super::responses::DeviceProblem;
use crate::operations::Leased;
use crate::operations::device::{self, Loop, LoopAnswer, StatisticsAnswer, Tared};

paths! {
    /// Get the gripping statistics
    #[utoipa::path(
        get, path = "/grippers/{gripper}/statistics", operation_id = "get_statistics", tag = "device",
        params(GripperPath),
        responses((status = 200, description = "The statistics", body = StatisticsAnswer), DeviceProblem)
    )]
    statistics => device::STATISTICS;
    /// Reset the gripping statistics
    ///
    /// Returns the statistics from before the reset.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/statistics/reset", operation_id = "reset_statistics", tag = "device",
        params(GripperPath, LeaseHeader),
        request_body(content = Option<Leased>, description = "The lease token; optional"),
        responses((status = 200, description = "The statistics before the reset", body = StatisticsAnswer), DeviceProblem)
    )]
    reset_statistics => device::RESET_STATISTICS;
    /// Tare the force sensor
    ///
    /// Requires a force measurement finger. Refused while a part is held.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/tare", operation_id = "tare", tag = "device",
        params(GripperPath, LeaseHeader),
        request_body(content = Option<Leased>, description = "The lease token; optional"),
        responses((status = 200, description = "The sensor was tared", body = Tared), DeviceProblem)
    )]
    tare => device::TARE;
    /// Test the link (Loop)
    ///
    /// The device echoes the bytes of the request. Use this request to check the link and measure its speed.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/loop", operation_id = "loop", tag = "device",
        params(GripperPath),
        request_body = Option<Loop>,
        responses((status = 200, description = "The echoed bytes", body = LoopAnswer), DeviceProblem)
    )]
    loop_back => device::LOOP;
}
