//! Paths of the fingers' interface (firmware 4 and up).

use super::parameters::{FingerPath, GripperPath, LeaseHeader};
use super::paths;
use super::responses::DeviceProblem;
use crate::operations::fingers::{self, FingerAnswer, FingerDataAnswer, Power, PowerAnswer};

paths! {
    /// Get a finger
    ///
    /// Returns the finger's type and flags (firmware 4 and up).
    #[utoipa::path(
        get, path = "/grippers/{gripper}/fingers/{finger}", operation_id = "get_finger", tag = "device",
        params(GripperPath, FingerPath),
        responses((status = 200, description = "The finger", body = FingerAnswer), DeviceProblem)
    )]
    one => fingers::INFO;
    /// Get a finger's data
    ///
    /// Returns one frame of the finger's measured data (firmware 4 and up).
    #[utoipa::path(
        get, path = "/grippers/{gripper}/fingers/{finger}/data", operation_id = "get_finger_data", tag = "device",
        params(GripperPath, FingerPath),
        responses((status = 200, description = "The data", body = FingerDataAnswer), DeviceProblem)
    )]
    data => fingers::DATA;
    /// Switch a finger's power
    ///
    /// Supported by generic fingers only (firmware 4 and up). Switching on takes about half a second.
    #[utoipa::path(
        put, path = "/grippers/{gripper}/fingers/{finger}/power", operation_id = "set_finger_power", tag = "device",
        params(GripperPath, FingerPath, LeaseHeader),
        request_body = Power,
        responses((status = 200, description = "The power was switched", body = PowerAnswer), DeviceProblem)
    )]
    power => fingers::POWER;
}
