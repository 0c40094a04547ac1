//! Paths of FAST STOP and its acknowledgement.

use super::parameters::{GripperPath, LeaseHeader};
use super::paths;
use super::responses::{DeviceProblem, FastStopProblem, FastStopsProblem};
use crate::operations::fast_stop::{self, Acknowledge, Acknowledged, AllFastStopAnswer, FastStopAnswer, FastStopBody};

paths! {
    /// FAST STOP a gripper
    ///
    /// Stops the gripper as fast as the device can and blocks all motion until the FAST STOP is acknowledged by its id.
    /// Needs no lease. The response comes once the device's flags confirm the FAST STOP, or after 250 ms, even when the
    /// link is down. The gateway repeats it until the device confirms it. FAST STOP is not a safety function in the
    /// sense of ISO 13850.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/fast-stop", operation_id = "fast_stop", tag = "fast stop",
        params(GripperPath),
        request_body = Option<FastStopBody>,
        responses((status = 200, description = "The FAST STOP is latched", body = FastStopAnswer), FastStopProblem)
    )]
    one => fast_stop::ONE;
    /// FAST STOP all grippers
    ///
    /// Sends a FAST STOP to all grippers of this gateway at once. FAST STOP is not a safety function in the sense of
    /// ISO 13850.
    #[utoipa::path(
        post, path = "/fast-stop", operation_id = "fast_stop_all", tag = "fast stop",
        request_body = Option<FastStopBody>,
        responses((status = 200, description = "All grippers are latched", body = AllFastStopAnswer), FastStopsProblem)
    )]
    all => fast_stop::ALL;
}

paths! {
    /// Acknowledge a FAST STOP or a fault
    ///
    /// Clears the FAST STOP with this id if it is the newest one and the device has confirmed it. Nothing moves.
    /// Without an id, acknowledges a fault of the device, such as the state `ERROR` or a fault flag, while no FAST STOP
    /// is latched. A request without an id needs the lease token if the gripper is leased.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/acknowledge", operation_id = "acknowledge", tag = "fast stop",
        params(GripperPath, LeaseHeader),
        request_body = Acknowledge,
        responses(
            (status = 200, description = "The FAST STOP is cleared, or the device accepted the acknowledgement", body = Acknowledged),
            DeviceProblem,
        )
    )]
    acknowledge => fast_stop::ACKNOWLEDGE;
}
