//! The manual's commands besides motions, settings and fingers: statistics, tare, Loop.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::gripper::{Failure, Rejection};
use crate::operations::calls::call::{Call, Gripper, Leased, NoFields};
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::Json;
use crate::operations::parameters::values::bytes;
use crate::operations::problem::Problem;
use crate::wsg::id::MAX_LOOP_BYTES;
use crate::wsg::{self, Data, LoopData};

operations! {
    /// Get the gripping statistics
    STATISTICS = GET "/grippers/{gripper}/statistics" as "statistics" {
        run: statistics, id: "get_statistics", tag: "device", problems: DEVICE,
        answer: "The statistics",
    };

    /// Reset the gripping statistics
    ///
    /// Returns the statistics from before the reset.
    RESET_STATISTICS = POST "/grippers/{gripper}/statistics/reset" as "statistics.reset" {
        run: reset_statistics, id: "reset_statistics", tag: "device", problems: DEVICE,
        answer: "The statistics before the reset",
    };

    /// Tare the force sensor
    ///
    /// Requires a force measurement finger. Refused while a part is held.
    TARE = POST "/grippers/{gripper}/tare" as "tare" {
        run: tare, id: "tare", tag: "device", problems: DEVICE,
        answer: "The sensor was tared",
    };

    /// Test the link (Loop)
    ///
    /// The device echoes the bytes of the request. Use this request to check the link and measure its speed.
    LOOP = POST "/grippers/{gripper}/loop" as "loop" {
        run: loop_back, id: "loop_back", tag: "device", problems: DEVICE,
        answer: "The echoed bytes",
    };
}

/// A function that returns the value of one variant.
macro_rules! only {
    ($variant:path) => {
        |data| if let $variant(value) = data { Some(value) } else { None }
    };
}
pub(in crate::operations) use only;

/// Sends a request to the device, and extracts the expected data from the reply.
pub(in crate::operations) async fn ask<T>(
    gripper: &Gripper,
    command: wsg::Command,
    take: impl FnOnce(Data) -> Option<T>,
) -> Result<T, Rejection> {
    let name = wsg::id::name(command.id()).unwrap_or("a custom command");
    take(gripper.exchange(command).await?).ok_or_else(|| {
        let detail = "the reply belongs to another command".to_owned();
        Failure::DeviceProtocol { command: name, detail }.into()
    })
}

/// Grip statistics, counted by the device.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "total": 1520, "no_part": 12, "lost_part": 1}))]
pub struct StatisticsAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Grips executed.
    #[schema(format = Int64, minimum = 0, maximum = 4_294_967_295_i64)]
    total: u32,
    /// Grips that found no part.
    #[schema(minimum = 0, maximum = 65535)]
    no_part: u16,
    /// Grips whose part was lost before the gripper was opened again.
    #[schema(minimum = 0, maximum = 65535)]
    lost_part: u16,
}

async fn count(gripper: Gripper, reset: bool) -> Result<Json<StatisticsAnswer>, Problem> {
    let counts = ask(&gripper, wsg::Command::GetStatistics { reset }, only!(Data::Statistics)).await?;
    let wsg::Statistics { total, no_part, lost_part } = counts;
    Ok(Json(StatisticsAnswer { gripper: gripper.name(), total, no_part, lost_part }))
}

async fn statistics(call: Call<NoFields>) -> Result<Json<StatisticsAnswer>, Problem> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    count(gripper, false).await
}

async fn reset_statistics(call: Call<Leased>) -> Result<Json<StatisticsAnswer>, Problem> {
    count(call.leased()?, true).await
}

/// Result of a tare of the force sensor.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gripper": "left", "tared": true}))]
pub struct Tared {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Always true: a failure is reported as a problem.
    tared: bool,
}

async fn tare(call: Call<Leased>) -> Result<Json<Tared>, Problem> {
    let gripper = call.leased()?;
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

async fn loop_back(call: Call<Loop>) -> Result<Json<LoopAnswer>, Problem> {
    let (gripper, body): (_, Loop) = call.gripper_and_fields()?;
    let given = bytes("data", &body.data, MAX_LOOP_BYTES)?;
    let sent = given.len();
    let data = LoopData::new(given).ok_or_else(|| Problem::too_long("data", sent, MAX_LOOP_BYTES))?;
    let answer = ask(&gripper, wsg::Command::Loop(data), only!(Data::Loop)).await?;
    Ok(Json(LoopAnswer { gripper: gripper.name(), data: hex::encode(answer) }))
}
