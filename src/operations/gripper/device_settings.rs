//! The device's settings. Each has one shape for reading and writing. A write returns the value that the device
//! applied, since the device clamps values beyond its limits.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::device::{ask, only};
use crate::gripper::{Failure, Now, Rejection};
use crate::model::Code;
use crate::operations::calls::call::{Call, Gripper, Leased, NoFields};
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::Json;
use crate::operations::parameters::values::{LeaseField, acceleration, force, width};
use crate::operations::problem::Problem;
use crate::wsg::{self, Data, DeviceTag, InvalidDeviceTag, SoftLimits, Status, SystemState};

operations! {
    /// Get the acceleration
    GET_ACCELERATION = GET "/grippers/{gripper}/settings/acceleration" as "settings.acceleration" {
        run: get_acceleration, id: "get_acceleration", tag: "settings", problems: DEVICE,
        answer: "The acceleration",
    };

    /// Set the acceleration
    SET_ACCELERATION = PUT "/grippers/{gripper}/settings/acceleration" as "settings.acceleration.set" {
        run: set_acceleration, id: "set_acceleration", tag: "settings", problems: DEVICE,
        answer: "The acceleration now in use",
    };

    /// Get the force limit
    GET_FORCE_LIMIT = GET "/grippers/{gripper}/settings/force-limit" as "settings.force-limit" {
        run: get_force_limit, id: "get_force_limit", tag: "settings", problems: DEVICE,
        answer: "The force limit",
    };

    /// Set the force limit
    SET_FORCE_LIMIT = PUT "/grippers/{gripper}/settings/force-limit" as "settings.force-limit.set" {
        run: set_force_limit, id: "set_force_limit", tag: "settings", problems: DEVICE,
        answer: "The force limit now in use",
    };

    /// Get the soft limits
    GET_SOFT_LIMITS = GET "/grippers/{gripper}/settings/soft-limits" as "settings.soft-limits" {
        run: get_soft_limits, id: "get_soft_limits", tag: "settings", problems: DEVICE,
        answer: "The soft limits; null if none are set",
    };

    /// Set the soft limits
    ///
    /// Forbids widths outside the soft limits. A motion to a forbidden width is refused, and fingers that reach a
    /// forbidden width are stopped by a FAST STOP.
    SET_SOFT_LIMITS = PUT "/grippers/{gripper}/settings/soft-limits" as "settings.soft-limits.set" {
        run: set_soft_limits, id: "set_soft_limits", tag: "settings", problems: DEVICE,
        answer: "The soft limits now in use",
    };

    /// Clear the soft limits
    CLEAR_SOFT_LIMITS = DELETE "/grippers/{gripper}/settings/soft-limits" as "settings.soft-limits.clear" {
        run: clear_soft_limits, id: "clear_soft_limits", tag: "settings", problems: DEVICE,
        answer: "The soft limits are cleared",
    };

    /// Get Overdrive Mode
    GET_OVERDRIVE = GET "/grippers/{gripper}/settings/overdrive" as "settings.overdrive" {
        run: get_overdrive, id: "get_overdrive", tag: "settings", problems: DEVICE,
        answer: "Whether Overdrive Mode is on",
    };

    /// Switch Overdrive Mode
    ///
    /// Switching off reduces a force limit above the nominal force to the nominal force. Not every model has Overdrive
    /// Mode.
    SET_OVERDRIVE = PUT "/grippers/{gripper}/settings/overdrive" as "settings.overdrive.set" {
        run: set_overdrive, id: "set_overdrive", tag: "settings", problems: DEVICE,
        answer: "Overdrive Mode as now set",
    };

    /// Get the device tag
    GET_TAG = GET "/grippers/{gripper}/settings/device-tag" as "settings.device-tag" {
        run: get_tag, id: "get_device_tag", tag: "settings", problems: DEVICE,
        answer: "The device tag; null if none is set",
    };

    /// Set the device tag
    ///
    /// Each write wears the device's flash memory. The gateway therefore accepts one write a second from all clients
    /// together and refuses more with 429. A tag that the device is known to have is not written again.
    SET_TAG = PUT "/grippers/{gripper}/settings/device-tag" as "settings.device-tag.set" {
        run: set_tag, id: "set_device_tag", tag: "settings", problems: DEVICE,
        answer: "The device tag now stored",
    };
}

type SettingResult<T> = Result<Json<T>, Problem>;

/// Turns `E_NOT_AVAILABLE` into `None`: the device has no value set.
fn none_if_not_available<T>(optional: Result<Option<T>, Rejection>) -> Result<Option<T>, Rejection> {
    match optional {
        Err(Rejection::Device(refusal)) if refusal.status == Status::E_NOT_AVAILABLE => Ok(None),
        other => other,
    }
}

/// The acceleration.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "acceleration_mm_s2": 2000.0}))]
pub struct AccelerationAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Acceleration in mm/s².
    #[schema(minimum = 0, maximum = 1_000_000)]
    acceleration_mm_s2: f32,
}

/// An acceleration to set.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"acceleration_mm_s2": 2000.0}))]
pub struct AccelerationSetting {
    /// Acceleration in mm/s².
    #[schema(minimum = 0, maximum = 1_000_000)]
    acceleration_mm_s2: f64,
    lease: Option<LeaseField>,
}

async fn exchange_acceleration(gripper: Gripper, command: wsg::Command) -> SettingResult<AccelerationAnswer> {
    let value = ask(&gripper, command, only!(Data::Acceleration)).await?;
    Ok(Json(AccelerationAnswer { gripper: gripper.name(), acceleration_mm_s2: value.mm_s2() }))
}

async fn get_acceleration(call: Call<NoFields>) -> SettingResult<AccelerationAnswer> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    exchange_acceleration(gripper, wsg::Command::GetAcceleration).await
}

async fn set_acceleration(call: Call<AccelerationSetting>) -> SettingResult<AccelerationAnswer> {
    let (gripper, body): (_, AccelerationSetting) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    let acceleration = acceleration("acceleration_mm_s2", body.acceleration_mm_s2)?;
    exchange_acceleration(gripper, wsg::Command::SetAcceleration(acceleration)).await
}

/// The force limit.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "force_n": 40.0}))]
pub struct ForceLimitAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Force limit in N, the sum over the fingers.
    #[schema(minimum = 0, maximum = 10000)]
    force_n: f32,
}

/// A force limit to set.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"force_n": 40.0}))]
pub struct ForceLimitSetting {
    /// Force limit in N, the sum over the fingers.
    #[schema(minimum = 0, maximum = 10000)]
    force_n: f64,
    lease: Option<LeaseField>,
}

async fn exchange_force_limit(gripper: Gripper, command: wsg::Command) -> SettingResult<ForceLimitAnswer> {
    let value = ask(&gripper, command, only!(Data::ForceLimit)).await?;
    Ok(Json(ForceLimitAnswer { gripper: gripper.name(), force_n: value.n() }))
}

async fn get_force_limit(call: Call<NoFields>) -> SettingResult<ForceLimitAnswer> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    exchange_force_limit(gripper, wsg::Command::GetForceLimit).await
}

async fn set_force_limit(call: Call<ForceLimitSetting>) -> SettingResult<ForceLimitAnswer> {
    let (gripper, body): (_, ForceLimitSetting) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    exchange_force_limit(gripper, wsg::Command::SetForceLimit(force("force_n", body.force_n)?)).await
}

/// The soft limits.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "minus_mm": 10.0, "plus_mm": 60.0}))]
pub struct SoftLimitsAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Smallest allowed width in mm; null if none is set.
    #[schema(required, minimum = -1000, maximum = 1000)]
    minus_mm: Option<f32>,
    /// Largest allowed width in mm; null if none is set.
    #[schema(required, minimum = -1000, maximum = 1000)]
    plus_mm: Option<f32>,
}

/// Soft limits to set.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"minus_mm": 10.0, "plus_mm": 60.0}))]
pub struct SoftLimitsSetting {
    /// Smallest allowed width in mm.
    #[schema(minimum = 0, maximum = 1000)]
    minus_mm: f64,
    /// Largest allowed width in mm.
    #[schema(minimum = 0, maximum = 1000)]
    plus_mm: f64,
    lease: Option<LeaseField>,
}

async fn exchange_soft_limits(gripper: Gripper, command: wsg::Command) -> SettingResult<SoftLimitsAnswer> {
    let reply = ask(&gripper, command, |data| match data {
        Data::SoftLimits(value) => Some(Some(value)),
        Data::None => Some(None),
        _ => None,
    });
    let value = none_if_not_available(reply.await)?;
    Ok(Json(SoftLimitsAnswer {
        gripper: gripper.name(),
        minus_mm: value.map(|limits| limits.minus().mm()),
        plus_mm: value.map(|limits| limits.plus().mm()),
    }))
}

async fn get_soft_limits(call: Call<NoFields>) -> SettingResult<SoftLimitsAnswer> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    exchange_soft_limits(gripper, wsg::Command::GetSoftLimits).await
}

async fn set_soft_limits(call: Call<SoftLimitsSetting>) -> SettingResult<SoftLimitsAnswer> {
    let (gripper, body): (_, SoftLimitsSetting) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    let minus = width("minus_mm", body.minus_mm)?;
    let plus = width("plus_mm", body.plus_mm)?;
    let limits = SoftLimits::new(minus, plus)
        .ok_or_else(|| Problem::out_of_range("minus_mm", body.minus_mm, 0.0, body.plus_mm))?;
    exchange_soft_limits(gripper, wsg::Command::SetSoftLimits(limits)).await
}

async fn clear_soft_limits(call: Call<Leased>) -> SettingResult<SoftLimitsAnswer> {
    exchange_soft_limits(call.leased()?, wsg::Command::ClearSoftLimits).await
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

/// Overdrive Mode to set.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"enabled": false}))]
pub struct OverdriveSetting {
    /// Whether the force limit may go up to the overdrive force.
    enabled: bool,
    lease: Option<LeaseField>,
}

fn overdrive_of(gripper: &Gripper, state: SystemState) -> Json<OverdriveAnswer> {
    Json(OverdriveAnswer { gripper: gripper.name(), enabled: state.contains(SystemState::OVERDRIVE_MODE) })
}

fn get_overdrive(call: &Call<NoFields>) -> SettingResult<OverdriveAnswer> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    let state = gripper.handle.state();
    let now = Now::read().instant;
    if let Some(flags) = state.values.flags(now) {
        return Ok(overdrive_of(&gripper, flags));
    }
    let failure = if let Some(missing) = state.values.flags.missing(now) {
        Failure::ValueUnknown { command: "GetSystemState", cause: missing.to_string() }
    } else {
        let url = gripper.handle.info().url.clone();
        Failure::LinkDown { link: state.link, url, cause: state.link_cause.clone() }
    };
    Err(failure.into())
}

async fn set_overdrive(call: Call<OverdriveSetting>) -> SettingResult<OverdriveAnswer> {
    let (gripper, body): (_, OverdriveSetting) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    let state = ask(&gripper, wsg::Command::OverdriveMode { on: body.enabled }, only!(Data::SystemState)).await?;
    Ok(overdrive_of(&gripper, state))
}

/// The device tag.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "tag": "cell 7"}))]
pub struct TagAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// The tag; null if none is set.
    #[schema(required, max_length = 64)]
    tag: Option<String>,
}

/// A device tag to set.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"tag": "cell 7"}))]
pub struct TagSetting {
    /// The tag: at most 64 printable ASCII characters; before firmware 4, also of ISO 8859-1.
    #[schema(max_length = 64, pattern = "^[ -~\\u00a0-\\u00ff]*$")]
    tag: String,
    lease: Option<LeaseField>,
}

async fn exchange_tag(gripper: Gripper, command: wsg::Command) -> SettingResult<TagAnswer> {
    let reply = ask(&gripper, command, |data| match data {
        Data::DeviceTag(tag) => Some(Some(tag)),
        Data::None => Some(None),
        _ => None,
    });
    let tag = none_if_not_available(reply.await)?;
    Ok(Json(TagAnswer { gripper: gripper.name(), tag: tag.map(|tag| tag.text()) }))
}

async fn get_tag(call: Call<NoFields>) -> SettingResult<TagAnswer> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    exchange_tag(gripper, wsg::Command::GetDeviceTag).await
}

async fn set_tag(call: Call<TagSetting>) -> SettingResult<TagAnswer> {
    let (gripper, TagSetting { tag, lease }) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(lease.as_deref())?;
    let new = DeviceTag::from_text(&tag).map_err(|error| refused_tag(&tag, error))?;
    // fw2 strips trailing NULs, so a tag that ends in them is refused rather than changed.
    if tag.ends_with('\0') || (!new.is_ascii() && gripper.handle.info().demands_ascii_tags()) {
        return Err(refused_tag(&tag, InvalidDeviceTag::IllegalCharacter));
    }
    exchange_tag(gripper, wsg::Command::SetDeviceTag(new)).await
}

fn refused_tag(tag: &str, error: InvalidDeviceTag) -> Problem {
    match error {
        InvalidDeviceTag::TooLong => Problem::too_long("tag", tag.chars().count(), DeviceTag::MAX_BYTES),
        InvalidDeviceTag::IllegalCharacter => {
            Problem::new(Code::Malformed, error.to_string()).field("tag").value(Some(tag.into()))
        }
    }
}
