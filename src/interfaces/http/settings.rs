//! The device's settings. Each is read and written in one shape, and a write answers with what the device made of it:
//! it clamps what it can't do.

use axum::Json;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::body::Body;
use super::device::ask;
use super::errors::{Code, Problem};
use super::extract::{Gripper, GripperPath, LeaseHeader};
use super::responses::DeviceProblem;
use super::values::{acceleration, force, width};
use crate::gripper::{Failure, Rejection};
use crate::wsg::{self, Data, DeviceTag, InvalidDeviceTag, SoftLimits, Status, SystemState};

type Answer<T> = Result<Json<T>, Problem>;

/// What `optional` is where the device has none set.
fn none_if_not_available<T>(optional: Result<Option<T>, Rejection>) -> Result<Option<T>, Rejection> {
    match optional {
        Err(Rejection::Device(refusal)) if refusal.status == Status::E_NOT_AVAILABLE => Ok(None),
        told => told,
    }
}

/// The acceleration.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "acceleration_mm_s2": 2000.0}))]
pub struct AccelerationAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// In mm/s².
    #[schema(minimum = 0, maximum = 1_000_000)]
    acceleration_mm_s2: f32,
}

/// An acceleration to set.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"acceleration_mm_s2": 2000.0}))]
pub struct AccelerationSetting {
    /// In mm/s².
    #[schema(minimum = 0, maximum = 1_000_000)]
    acceleration_mm_s2: f64,
    /// The lease's token of at most 64 bytes, while somebody holds one; empty is none.
    #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    lease: Option<String>,
}

async fn tell_acceleration(gripper: Gripper, command: wsg::Command) -> Answer<AccelerationAnswer> {
    let take = |data| if let Data::Acceleration(told) = data { Some(told) } else { None };
    let told = ask(&gripper, command, take).await?;
    Ok(Json(AccelerationAnswer { gripper: gripper.name(), acceleration_mm_s2: told.mm_s2() }))
}

/// The acceleration
#[utoipa::path(
    get, path = "/grippers/{gripper}/settings/acceleration", operation_id = "get_acceleration", tag = "settings",
    params(GripperPath),
    responses((status = 200, description = "The acceleration", body = AccelerationAnswer), DeviceProblem)
)]
pub async fn get_acceleration(gripper: Gripper) -> Answer<AccelerationAnswer> {
    tell_acceleration(gripper, wsg::Command::GetAcceleration).await
}

/// Set the acceleration
#[utoipa::path(
    put, path = "/grippers/{gripper}/settings/acceleration", operation_id = "set_acceleration", tag = "settings",
    params(GripperPath, LeaseHeader),
    request_body = AccelerationSetting,
    responses((status = 200, description = "What the device made of it", body = AccelerationAnswer), DeviceProblem)
)]
pub async fn set_acceleration(gripper: Gripper, Body(body): Body<AccelerationSetting>) -> Answer<AccelerationAnswer> {
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    let acceleration = acceleration("acceleration_mm_s2", body.acceleration_mm_s2)?;
    tell_acceleration(gripper, wsg::Command::SetAcceleration(acceleration)).await
}

/// The force limit.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "force_n": 40.0}))]
pub struct ForceLimitAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// In N, the sum over the fingers.
    #[schema(minimum = 0, maximum = 10000)]
    force_n: f32,
}

/// A force limit to set.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"force_n": 40.0}))]
pub struct ForceLimitSetting {
    /// In N, the sum over the fingers.
    #[schema(minimum = 0, maximum = 10000)]
    force_n: f64,
    /// The lease's token of at most 64 bytes, while somebody holds one; empty is none.
    #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    lease: Option<String>,
}

async fn tell_force_limit(gripper: Gripper, command: wsg::Command) -> Answer<ForceLimitAnswer> {
    let take = |data| if let Data::ForceLimit(told) = data { Some(told) } else { None };
    let told = ask(&gripper, command, take).await?;
    Ok(Json(ForceLimitAnswer { gripper: gripper.name(), force_n: told.n() }))
}

/// The force limit
#[utoipa::path(
    get, path = "/grippers/{gripper}/settings/force-limit", operation_id = "get_force_limit", tag = "settings",
    params(GripperPath),
    responses((status = 200, description = "The force limit", body = ForceLimitAnswer), DeviceProblem)
)]
pub async fn get_force_limit(gripper: Gripper) -> Answer<ForceLimitAnswer> {
    tell_force_limit(gripper, wsg::Command::GetForceLimit).await
}

/// Set the force limit
#[utoipa::path(
    put, path = "/grippers/{gripper}/settings/force-limit", operation_id = "set_force_limit", tag = "settings",
    params(GripperPath, LeaseHeader),
    request_body = ForceLimitSetting,
    responses((status = 200, description = "What the device made of it", body = ForceLimitAnswer), DeviceProblem)
)]
pub async fn set_force_limit(gripper: Gripper, Body(body): Body<ForceLimitSetting>) -> Answer<ForceLimitAnswer> {
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    tell_force_limit(gripper, wsg::Command::SetForceLimit(force("force_n", body.force_n)?)).await
}

/// The soft limits.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "minus_mm": 10.0, "plus_mm": 60.0}))]
pub struct SoftLimitsAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// The smallest allowed width; null where none is set.
    #[schema(required, minimum = -1000, maximum = 1000)]
    minus_mm: Option<f32>,
    /// The largest allowed width; null where none is set.
    #[schema(required, minimum = -1000, maximum = 1000)]
    plus_mm: Option<f32>,
}

/// Soft limits to set.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"minus_mm": 10.0, "plus_mm": 60.0}))]
pub struct SoftLimitsSetting {
    /// The smallest allowed width.
    #[schema(minimum = 0, maximum = 1000)]
    minus_mm: f64,
    /// The largest allowed width.
    #[schema(minimum = 0, maximum = 1000)]
    plus_mm: f64,
    /// The lease's token of at most 64 bytes, while somebody holds one; empty is none.
    #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    lease: Option<String>,
}

async fn tell_soft_limits(gripper: Gripper, command: wsg::Command) -> Answer<SoftLimitsAnswer> {
    let take = |data| match data {
        Data::SoftLimits(told) => Some(Some(told)),
        Data::None => Some(None),
        _ => None,
    };
    let told = none_if_not_available(ask(&gripper, command, take).await)?;
    Ok(Json(SoftLimitsAnswer {
        gripper: gripper.name(),
        minus_mm: told.map(|limits| limits.minus().mm()),
        plus_mm: told.map(|limits| limits.plus().mm()),
    }))
}

/// The soft limits
#[utoipa::path(
    get, path = "/grippers/{gripper}/settings/soft-limits", operation_id = "get_soft_limits", tag = "settings",
    params(GripperPath),
    responses((status = 200, description = "The soft limits, null where none are set", body = SoftLimitsAnswer), DeviceProblem)
)]
pub async fn get_soft_limits(gripper: Gripper) -> Answer<SoftLimitsAnswer> {
    tell_soft_limits(gripper, wsg::Command::GetSoftLimits).await
}

/// Set the soft limits
///
/// Widths outside of them are forbidden: a motion to one is refused, and fingers that get there are stopped by a FAST
/// STOP.
#[utoipa::path(
    put, path = "/grippers/{gripper}/settings/soft-limits", operation_id = "set_soft_limits", tag = "settings",
    params(GripperPath, LeaseHeader),
    request_body = SoftLimitsSetting,
    responses((status = 200, description = "What the device made of them", body = SoftLimitsAnswer), DeviceProblem)
)]
pub async fn set_soft_limits(gripper: Gripper, Body(body): Body<SoftLimitsSetting>) -> Answer<SoftLimitsAnswer> {
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    let (minus, plus) = (width("minus_mm", body.minus_mm)?, width("plus_mm", body.plus_mm)?);
    let limits = SoftLimits::new(minus, plus)
        .ok_or_else(|| Problem::out_of_range("minus_mm", body.minus_mm, 0.0, body.plus_mm))?;
    tell_soft_limits(gripper, wsg::Command::SetSoftLimits(limits)).await
}

/// Clear the soft limits
#[utoipa::path(
    delete, path = "/grippers/{gripper}/settings/soft-limits", operation_id = "clear_soft_limits", tag = "settings",
    params(GripperPath, LeaseHeader),
    responses((status = 200, description = "None are set any more", body = SoftLimitsAnswer), DeviceProblem)
)]
pub async fn clear_soft_limits(gripper: Gripper) -> Answer<SoftLimitsAnswer> {
    tell_soft_limits(gripper.with_lease(None)?, wsg::Command::ClearSoftLimits).await
}

/// Overdrive Mode.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "enabled": false}))]
pub struct OverdriveAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Whether the force limit may go up to the overdrive force.
    enabled: bool,
}

/// Overdrive Mode, to switch.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"enabled": false}))]
pub struct OverdriveSetting {
    /// Whether the force limit may go up to the overdrive force.
    enabled: bool,
    /// The lease's token of at most 64 bytes, while somebody holds one; empty is none.
    #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    lease: Option<String>,
}

fn overdrive_of(gripper: &Gripper, state: SystemState) -> Json<OverdriveAnswer> {
    Json(OverdriveAnswer { gripper: gripper.name(), enabled: state.contains(SystemState::OVERDRIVE_MODE) })
}

/// Overdrive Mode
#[utoipa::path(
    get, path = "/grippers/{gripper}/settings/overdrive", operation_id = "get_overdrive", tag = "settings",
    params(GripperPath),
    responses((status = 200, description = "Whether it is on", body = OverdriveAnswer), DeviceProblem)
)]
pub async fn get_overdrive(gripper: Gripper) -> Answer<OverdriveAnswer> {
    let state = gripper.handle.state();
    let never_heard = || Failure::LinkDown {
        link: state.link,
        cause: state.link_cause.clone().unwrap_or_else(|| "the device has not told its flags yet".to_owned()),
    };
    let flags = state.flags_raw.ok_or_else(never_heard)?;
    Ok(overdrive_of(&gripper, SystemState::from_bits_retain(flags)))
}

/// Switch Overdrive Mode
///
/// Off reduces a force limit above the nominal force to it. Not on every model.
#[utoipa::path(
    put, path = "/grippers/{gripper}/settings/overdrive", operation_id = "set_overdrive", tag = "settings",
    params(GripperPath, LeaseHeader),
    request_body = OverdriveSetting,
    responses((status = 200, description = "What the device made of it", body = OverdriveAnswer), DeviceProblem)
)]
pub async fn set_overdrive(gripper: Gripper, Body(body): Body<OverdriveSetting>) -> Answer<OverdriveAnswer> {
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    let take = |data| if let Data::SystemState(state) = data { Some(state) } else { None };
    let state = ask(&gripper, wsg::Command::OverdriveMode { on: body.enabled }, take).await?;
    Ok(overdrive_of(&gripper, state))
}

/// The device tag.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "tag": "cell 7"}))]
pub struct TagAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// The tag; null where none is set.
    #[schema(required, max_length = 64)]
    tag: Option<String>,
}

/// A device tag to set.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"tag": "cell 7"}))]
pub struct TagSetting {
    /// At most 64 printable ASCII characters.
    #[schema(max_length = 64, pattern = "^[ -~]*$")]
    tag: String,
    /// The lease's token of at most 64 bytes, while somebody holds one; empty is none.
    #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    lease: Option<String>,
}

async fn tell_tag(gripper: Gripper, command: wsg::Command) -> Answer<TagAnswer> {
    let take = |data| match data {
        Data::DeviceTag(tag) => Some(Some(tag)),
        Data::None => Some(None),
        _ => None,
    };
    let tag = none_if_not_available(ask(&gripper, command, take).await)?;
    Ok(Json(TagAnswer { gripper: gripper.name(), tag: tag.map(|tag| tag.as_str().to_owned()) }))
}

/// The device tag
#[utoipa::path(
    get, path = "/grippers/{gripper}/settings/device-tag", operation_id = "get_device_tag", tag = "settings",
    params(GripperPath),
    responses((status = 200, description = "The device tag, null where none is set", body = TagAnswer), DeviceProblem)
)]
pub async fn get_tag(gripper: Gripper) -> Answer<TagAnswer> {
    tell_tag(gripper, wsg::Command::GetDeviceTag).await
}

/// Set the device tag
///
/// Each write wears the device's flash memory: there is one a second at most, whoever asks, and more are refused with 429. A tag that the device is known to have is not written again.
#[utoipa::path(
    put, path = "/grippers/{gripper}/settings/device-tag", operation_id = "set_device_tag", tag = "settings",
    params(GripperPath, LeaseHeader),
    request_body = TagSetting,
    responses((status = 200, description = "What the device made of it", body = TagAnswer), DeviceProblem)
)]
pub async fn set_tag(gripper: Gripper, Body(TagSetting { tag, lease }): Body<TagSetting>) -> Answer<TagAnswer> {
    let gripper = gripper.with_lease(lease.as_deref())?;
    let refused = |error: InvalidDeviceTag| match error {
        InvalidDeviceTag::TooLong => Problem::too_long("tag", tag.len(), DeviceTag::MAX_BYTES),
        InvalidDeviceTag::IllegalCharacter => {
            Problem::new(Code::Malformed, error.to_string()).field("tag").value(Some(tag.clone().into()))
        }
    };
    // The device strips trailing NULs; a client that sends them gets to know that they aren't kept.
    let tag =
        if tag.ends_with('\0') { Err(InvalidDeviceTag::IllegalCharacter) } else { DeviceTag::new(tag.as_bytes()) };
    tell_tag(gripper, wsg::Command::SetDeviceTag(tag.map_err(refused)?)).await
}
