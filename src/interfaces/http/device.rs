//! What the manual has beside motions, settings and fingers: statistics, tare, Loop.

use axum::Json;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::body::{Body, Leased};
use super::errors::Problem;
use super::extract::{Gripper, GripperPath, LeaseHeader};
use super::responses::DeviceProblem;
use super::values::bytes;
use crate::gripper::{Failure, Rejection};
use crate::wsg::id::MAX_LOOP_BYTES;
use crate::wsg::{self, Data, LoopData};

/// Asks the device, and takes from its data what belongs to the question.
pub async fn ask<T>(
    gripper: &Gripper,
    command: wsg::Command,
    take: impl FnOnce(Data) -> Option<T>,
) -> Result<T, Rejection> {
    let name = wsg::id::name(command.id()).unwrap_or("a custom command");
    let other = || Failure::DeviceProtocol { command: name, detail: "it belongs to another command".to_owned() };
    take(gripper.exchange(command).await?).ok_or_else(|| other().into())
}

/// Grips, counted by the device.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "total": 1520, "no_part": 12, "lost_part": 1}))]
pub struct StatisticsAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Executed grips.
    #[schema(minimum = 0, maximum = 4_294_967_295_u64)]
    total: u32,
    /// Grips that found no part.
    #[schema(minimum = 0, maximum = 65535)]
    no_part: u16,
    /// Grips whose part was lost before the gripper was opened again.
    #[schema(minimum = 0, maximum = 65535)]
    lost_part: u16,
}

async fn count(gripper: Gripper, reset: bool) -> Result<Json<StatisticsAnswer>, Problem> {
    let take = |data| if let Data::Statistics(statistics) = data { Some(statistics) } else { None };
    let wsg::Statistics { total, no_part, lost_part } =
        ask(&gripper, wsg::Command::GetStatistics { reset }, take).await?;
    Ok(Json(StatisticsAnswer { gripper: gripper.name(), total, no_part, lost_part }))
}

/// The gripping statistics
#[utoipa::path(
    get, path = "/grippers/{gripper}/statistics", operation_id = "get_statistics", tag = "device",
    params(GripperPath),
    responses((status = 200, description = "The statistics", body = StatisticsAnswer), DeviceProblem)
)]
pub async fn statistics(gripper: Gripper) -> Result<Json<StatisticsAnswer>, Problem> {
    count(gripper, false).await
}

/// Reset the gripping statistics
///
/// Answers with what they were.
#[utoipa::path(
    post, path = "/grippers/{gripper}/statistics/reset", operation_id = "reset_statistics", tag = "device",
    params(GripperPath, LeaseHeader),
    request_body(content = Option<Leased>, description = "Nothing, or the lease's token"),
    responses((status = 200, description = "The statistics before the reset", body = StatisticsAnswer), DeviceProblem)
)]
pub async fn reset_statistics(
    gripper: Gripper,
    Body(Leased { lease }): Body<Leased>,
) -> Result<Json<StatisticsAnswer>, Problem> {
    count(gripper.with_lease(lease.as_deref())?, true).await
}

/// A force sensor, tared.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "tared": true}))]
pub struct Tared {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// That it was done.
    tared: bool,
}

/// Tare the force sensor
///
/// Needs a force measurement finger, and is refused while a part is held.
#[utoipa::path(
    post, path = "/grippers/{gripper}/tare", operation_id = "tare", tag = "device",
    params(GripperPath, LeaseHeader),
    request_body(content = Option<Leased>, description = "Nothing, or the lease's token"),
    responses((status = 200, description = "The sensor is tared", body = Tared), DeviceProblem)
)]
pub async fn tare(gripper: Gripper, Body(Leased { lease }): Body<Leased>) -> Result<Json<Tared>, Problem> {
    let gripper = gripper.with_lease(lease.as_deref())?;
    gripper.exchange(wsg::Command::TareForceSensor).await?;
    Ok(Json(Tared { gripper: gripper.name(), tared: true }))
}

/// Bytes for the device to send back.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"data": "0123456789abcdef"}))]
pub struct Loop {
    /// At most 256 bytes, as hex.
    #[serde(default)]
    #[schema(default = "", max_length = 512, pattern = "^([0-9a-fA-F]{2})*$")]
    data: String,
}

/// The bytes that the device sent back.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "data": "0123456789abcdef"}))]
pub struct LoopAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// The bytes, as hex.
    #[schema(max_length = 512)]
    data: String,
}

/// Loop
///
/// The device sends back what it gets: a check of the link, and of its speed.
#[utoipa::path(
    post, path = "/grippers/{gripper}/loop", operation_id = "loop", tag = "device",
    params(GripperPath),
    request_body = Option<Loop>,
    responses((status = 200, description = "The same bytes", body = LoopAnswer), DeviceProblem)
)]
pub async fn loop_back(gripper: Gripper, Body(body): Body<Loop>) -> Result<Json<LoopAnswer>, Problem> {
    let given = bytes("data", &body.data, MAX_LOOP_BYTES)?;
    let sent = given.len();
    let data = LoopData::new(given).ok_or_else(|| Problem::too_long("data", sent, MAX_LOOP_BYTES))?;
    let take = |data| if let Data::Loop(bytes) = data { Some(bytes) } else { None };
    let answer = ask(&gripper, wsg::Command::Loop(data), take).await?;
    Ok(Json(LoopAnswer { gripper: gripper.name(), data: hex::encode(answer) }))
}
