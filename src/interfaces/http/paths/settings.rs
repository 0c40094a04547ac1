//! Paths of the device's settings.

use super::parameters::{GripperPath, LeaseHeader};
use super::paths;
use super::responses::DeviceProblem;
use crate::operations::settings::{
    self, AccelerationAnswer, AccelerationSetting, ForceLimitAnswer, ForceLimitSetting, OverdriveAnswer,
    OverdriveSetting, SoftLimitsAnswer, SoftLimitsSetting, TagAnswer, TagSetting,
};

paths! {
    /// Get the acceleration
    #[utoipa::path(
        get, path = "/grippers/{gripper}/settings/acceleration", operation_id = "get_acceleration", tag = "settings",
        params(GripperPath),
        responses((status = 200, description = "The acceleration", body = AccelerationAnswer), DeviceProblem)
    )]
    get_acceleration => settings::GET_ACCELERATION;
    /// Set the acceleration
    #[utoipa::path(
        put, path = "/grippers/{gripper}/settings/acceleration", operation_id = "set_acceleration", tag = "settings",
        params(GripperPath, LeaseHeader),
        request_body = AccelerationSetting,
        responses((status = 200, description = "The acceleration now in use", body = AccelerationAnswer), DeviceProblem)
    )]
    set_acceleration => settings::SET_ACCELERATION;
    /// Get the force limit
    #[utoipa::path(
        get, path = "/grippers/{gripper}/settings/force-limit", operation_id = "get_force_limit", tag = "settings",
        params(GripperPath),
        responses((status = 200, description = "The force limit", body = ForceLimitAnswer), DeviceProblem)
    )]
    get_force_limit => settings::GET_FORCE_LIMIT;
    /// Set the force limit
    #[utoipa::path(
        put, path = "/grippers/{gripper}/settings/force-limit", operation_id = "set_force_limit", tag = "settings",
        params(GripperPath, LeaseHeader),
        request_body = ForceLimitSetting,
        responses((status = 200, description = "The force limit now in use", body = ForceLimitAnswer), DeviceProblem)
    )]
    set_force_limit => settings::SET_FORCE_LIMIT;
    /// Get the soft limits
    #[utoipa::path(
        get, path = "/grippers/{gripper}/settings/soft-limits", operation_id = "get_soft_limits", tag = "settings",
        params(GripperPath),
        responses((status = 200, description = "The soft limits; null if none are set", body = SoftLimitsAnswer), DeviceProblem)
    )]
    get_soft_limits => settings::GET_SOFT_LIMITS;
    /// Set the soft limits
    ///
    /// Forbids widths outside the soft limits. A motion to a forbidden width is refused, and fingers that reach a
    /// forbidden width are stopped by a FAST STOP.
    #[utoipa::path(
        put, path = "/grippers/{gripper}/settings/soft-limits", operation_id = "set_soft_limits", tag = "settings",
        params(GripperPath, LeaseHeader),
        request_body = SoftLimitsSetting,
        responses((status = 200, description = "The soft limits now in use", body = SoftLimitsAnswer), DeviceProblem)
    )]
    set_soft_limits => settings::SET_SOFT_LIMITS;
    /// Clear the soft limits
    #[utoipa::path(
        delete, path = "/grippers/{gripper}/settings/soft-limits", operation_id = "clear_soft_limits", tag = "settings",
        params(GripperPath, LeaseHeader),
        responses((status = 200, description = "The soft limits are cleared", body = SoftLimitsAnswer), DeviceProblem)
    )]
    clear_soft_limits => settings::CLEAR_SOFT_LIMITS;
    /// Get Overdrive Mode
    #[utoipa::path(
        get, path = "/grippers/{gripper}/settings/overdrive", operation_id = "get_overdrive", tag = "settings",
        params(GripperPath),
        responses((status = 200, description = "Whether Overdrive Mode is on", body = OverdriveAnswer), DeviceProblem)
    )]
    get_overdrive => settings::GET_OVERDRIVE;
    /// Switch Overdrive Mode
    ///
    /// Switching off reduces a force limit above the nominal force to the nominal force. Not every model has Overdrive
    /// Mode.
    #[utoipa::path(
        put, path = "/grippers/{gripper}/settings/overdrive", operation_id = "set_overdrive", tag = "settings",
        params(GripperPath, LeaseHeader),
        request_body = OverdriveSetting,
        responses((status = 200, description = "Overdrive Mode as now set", body = OverdriveAnswer), DeviceProblem)
    )]
    set_overdrive => settings::SET_OVERDRIVE;
    /// Get the device tag
    #[utoipa::path(
        get, path = "/grippers/{gripper}/settings/device-tag", operation_id = "get_device_tag", tag = "settings",
        params(GripperPath),
        responses((status = 200, description = "The device tag; null if none is set", body = TagAnswer), DeviceProblem)
    )]
    get_tag => settings::GET_TAG;
    /// Set the device tag
    ///
    /// Each write wears the device's flash memory. The gateway therefore accepts one write a second from all clients
    /// together and refuses more with 429. A tag that the device is known to have is not written again.
    #[utoipa::path(
        put, path = "/grippers/{gripper}/settings/device-tag", operation_id = "set_device_tag", tag = "settings",
        params(GripperPath, LeaseHeader),
        request_body = TagSetting,
        responses((status = 200, description = "The device tag now stored", body = TagAnswer), DeviceProblem)
    )]
    set_tag => settings::SET_TAG;
}
