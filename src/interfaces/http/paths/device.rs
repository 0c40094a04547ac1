//! The rest of the manual: statistics, tare, Loop.

use super::parameters::{GripperPath, LeaseHeader};
use super::paths;
use super::responses::DeviceProblem;
use crate::operations::Leased;
use crate::operations::device::{self, Loop, LoopAnswer, StatisticsAnswer, Tared};

paths! {
    /// The gripping statistics
    #[utoipa::path(
        get, path = "/grippers/{gripper}/statistics", operation_id = "get_statistics", tag = "device",
        params(GripperPath),
        responses((status = 200, description = "The statistics", body = StatisticsAnswer), DeviceProblem)
    )]
    statistics => device::STATISTICS;
    /// Reset the gripping statistics
    ///
    /// Answers with what they were.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/statistics/reset", operation_id = "reset_statistics", tag = "device",
        params(GripperPath, LeaseHeader),
        request_body(content = Option<Leased>, description = "Nothing, or the lease's token"),
        responses((status = 200, description = "The statistics before the reset", body = StatisticsAnswer), DeviceProblem)
    )]
    reset_statistics => device::RESET_STATISTICS;
    /// Tare the force sensor
    ///
    /// Needs a force measurement finger, and is refused while a part is held.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/tare", operation_id = "tare", tag = "device",
        params(GripperPath, LeaseHeader),
        request_body(content = Option<Leased>, description = "Nothing, or the lease's token"),
        responses((status = 200, description = "The sensor is tared", body = Tared), DeviceProblem)
    )]
    tare => device::TARE;
    /// Loop
    ///
    /// The device sends back what it gets: a check of the link, and of its speed.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/loop", operation_id = "loop", tag = "device",
        params(GripperPath),
        request_body = Option<Loop>,
        responses((status = 200, description = "The same bytes", body = LoopAnswer), DeviceProblem)
    )]
    loop_back => device::LOOP;
}
