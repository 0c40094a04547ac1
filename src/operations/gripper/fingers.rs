//! Operations on fingers (firmware 4 and up).

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::device::ask;
use crate::operations::calls::call::{Call, NoFields};
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::Json;
use crate::operations::parameters::values::LeaseField;
use crate::operations::problem::Problem;
use crate::wsg::{self, Data, Finger};

operations! {
    /// Get a finger
    ///
    /// Returns the finger's type and flags (firmware 4 and up).
    INFO = GET "/grippers/{gripper}/fingers/{finger}" as "fingers" {
        run: info, id: "get_finger", tag: "device", problems: DEVICE,
        answer: "The finger",
    };

    /// Get a finger's data
    ///
    /// Returns one frame of the finger's measured data (firmware 4 and up).
    DATA = GET "/grippers/{gripper}/fingers/{finger}/data" as "fingers.data" {
        run: data, id: "get_finger_data", tag: "device", problems: DEVICE,
        answer: "The data",
    };

    /// Switch a finger's power
    ///
    /// Supported by generic fingers only (firmware 4 and up). Switching on takes about half a second.
    POWER = PUT "/grippers/{gripper}/fingers/{finger}/power" as "fingers.power" {
        run: power, id: "set_finger_power", tag: "device", problems: DEVICE,
        answer: "The power was switched",
    };
}

/// Type and flags of a finger.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "finger": 1, "type": "WSG-FMF", "type_code": 1, "data_bytes": 4,
    "flags": ["POWER_ON", "CONFIG_AVAIL", "COMM_OPEN"], "flags_raw": 7
}))]
pub struct FingerAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Finger number.
    #[schema(minimum = 1, maximum = 2)]
    finger: u8,
    /// Finger type: `generic` (or no finger), `WSG-FMF` (force measurement), `WSG-DSA` (tactile), or `type` and a
    /// number.
    #[serde(rename = "type")]
    finger_type: String,
    /// Finger type as a number.
    #[schema(minimum = 0, maximum = 255)]
    type_code: u8,
    /// Size of one data frame in bytes; 0 if the finger sends no data.
    #[schema(minimum = 0, maximum = 65535)]
    data_bytes: u16,
    /// Names of the flags that are set.
    flags: Vec<&'static str>,
    /// All 16 flags as a number.
    #[schema(minimum = 0, maximum = 65535)]
    flags_raw: u16,
}

async fn info(call: Call<NoFields>) -> Result<Json<FingerAnswer>, Problem> {
    let gripper = call.gripper()?;
    let finger = call.finger()?;
    let NoFields {} = call.fields()?;
    let info = ask(&gripper, wsg::Command::GetFingerInfo(finger), |data| match data {
        Data::FingerInfo(_, info) => Some(info),
        _ => None,
    })
    .await?;
    let flags = ask(&gripper, wsg::Command::GetFingerFlags(finger), |data| match data {
        Data::FingerFlags(_, flags) => Some(flags),
        _ => None,
    })
    .await?;
    Ok(Json(FingerAnswer {
        gripper: gripper.name(),
        finger: number(finger),
        finger_type: info.finger_type.to_string(),
        type_code: info.finger_type.code(),
        data_bytes: info.data_bytes,
        flags: flags.names().collect(),
        flags_raw: flags.bits(),
    }))
}

const fn number(finger: Finger) -> u8 {
    match finger {
        Finger::One => 1,
        Finger::Two => 2,
    }
}

/// Data of a finger.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "finger": 1, "data": "0000a041"}))]
pub struct FingerDataAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Finger number.
    #[schema(minimum = 1, maximum = 2)]
    finger: u8,
    /// One data frame, as hex. Its meaning depends on the finger.
    #[schema(max_length = 8192)]
    data: String,
}

async fn data(call: Call<NoFields>) -> Result<Json<FingerDataAnswer>, Problem> {
    let gripper = call.gripper()?;
    let finger = call.finger()?;
    let NoFields {} = call.fields()?;
    let data = ask(&gripper, wsg::Command::GetFingerData(finger), |data| match data {
        Data::FingerData(_, bytes) => Some(bytes),
        _ => None,
    })
    .await?;
    Ok(Json(FingerDataAnswer { gripper: gripper.name(), finger: number(finger), data: hex::encode(data) }))
}

/// Finger power to set.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"enabled": true}))]
pub struct Power {
    /// Whether the power is on.
    enabled: bool,
    lease: Option<LeaseField>,
}

/// Power of a finger.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "finger": 1, "enabled": true}))]
pub struct PowerAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Finger number.
    #[schema(minimum = 1, maximum = 2)]
    finger: u8,
    /// Whether the power is on.
    enabled: bool,
}

async fn power(call: Call<Power>) -> Result<Json<PowerAnswer>, Problem> {
    let gripper = call.gripper()?;
    let finger = call.finger()?;
    let Power { enabled, lease } = call.fields()?;
    let gripper = gripper.with_lease(lease.as_deref())?;
    gripper.exchange(wsg::Command::FingerPower { finger, on: enabled }).await?;
    Ok(Json(PowerAnswer { gripper: gripper.name(), finger: number(finger), enabled }))
}
