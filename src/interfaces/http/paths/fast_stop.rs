//! FAST STOP and its acknowledge.

use super::parameters::{GripperPath, LeaseHeader};
use super::paths;
use super::responses::{AnyProblem, DeviceProblem, GripperProblem};
use crate::operations::fast_stop::{self, Acknowledge, Acknowledged, AllFastStopAnswer, FastStopAnswer, FastStopBody};

paths! {
    /// FAST STOP
    ///
    /// Stops the fastest way, needs no lease, and holds until it is acknowledged by its id: no motion until then. Answers
    /// once the device's flags show it, or after 250 ms, also when the link is down; it is repeated until they do. It is
    /// not a safety function in the sense of ISO 13850.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/fast-stop", operation_id = "fast_stop", tag = "fast stop",
        params(GripperPath),
        request_body = Option<FastStopBody>,
        responses((status = 200, description = "It is latched", body = FastStopAnswer), GripperProblem)
    )]
    one => fast_stop::ONE;
    /// FAST STOP of all grippers
    ///
    /// The same for all grippers of this gateway at once.
    #[utoipa::path(
        post, path = "/fast-stop", operation_id = "fast_stop_all", tag = "fast stop",
        request_body = Option<FastStopBody>,
        responses((status = 200, description = "All are latched", body = AllFastStopAnswer), AnyProblem)
    )]
    all => fast_stop::ALL;
}

paths! {
    /// Acknowledge a FAST STOP
    ///
    /// Clears the FAST STOP of this id, if it is the newest, and confirmed by the device. Nothing moves.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/acknowledge", operation_id = "acknowledge", tag = "fast stop",
        params(GripperPath, LeaseHeader),
        request_body = Acknowledge,
        responses((status = 200, description = "The device's flags show that it is gone", body = Acknowledged), DeviceProblem)
    )]
    acknowledge => fast_stop::ACKNOWLEDGE;
}
