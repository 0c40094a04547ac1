//! Home, move, grip, release, stop.

use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;

use super::body::Body;
use super::commands::{self, Told, Wait};
use super::errors::Problem;
use super::extract::{Gripper, GripperPath, KeyHeaders, Keys, WaitQuery};
use super::responses::DeviceProblem;
use super::values::{force, speed, text, width};
use crate::gripper::model::{Action, Direction, Motion, OnBlock};
use crate::wsg::MoveFlags;

/// Declares a command's body: its own fields, and those that all of them have.
macro_rules! command_body {
    ($(#[$meta:meta])* $name:ident { $($fields:tt)* }) => {
        #[derive(Debug, Deserialize, ToSchema)]
        #[serde(deny_unknown_fields)]
        $(#[$meta])*
        pub struct $name {
            $($fields)*
            /// Makes the request safe to repeat: the same id gives the same command for 10 minutes. At most 64 bytes;
            /// empty is none.
            #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
            request_id: Option<String>,
            /// The lease's token of at most 64 bytes, while somebody holds one; empty is none.
            #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
            lease: Option<String>,
        }

        impl $name {
            fn keys(&self, headers: Keys) -> Result<Keys, Problem> {
                headers.or_body(self.request_id.as_deref(), self.lease.as_deref())
            }
        }
    };
}

command_body! {
    /// A homing.
    #[schema(example = json!({"direction": "default"}))]
    Home {
        /// To which end stop.
        #[serde(default)]
        #[schema(default = "default")]
        direction: Direction,
    }
}

command_body! {
    /// A positioning of the fingers.
    #[schema(example = json!({"width_mm": 40.0, "speed_mm_s": 100.0}))]
    Move {
        /// The opening width to move to, or the change of it, in mm.
        #[schema(minimum = -1000, maximum = 1000)]
        width_mm: f64,
        /// The speed of the fingers relative to each other, in mm/s.
        #[schema(minimum = 0, maximum = 10000)]
        speed_mm_s: f64,
        /// Whether the width is a change of the current one.
        #[serde(default)]
        #[schema(default = false)]
        relative: bool,
        /// What happens when the fingers meet an obstacle.
        #[serde(default)]
        #[schema(default = "stop")]
        on_block: OnBlock,
    }
}

command_body! {
    /// A grip.
    #[schema(example = json!({"width_mm": 20.0, "speed_mm_s": 50.0, "force_n": 40.0, "part_id": "A-1047"}))]
    Grip {
        /// The part's nominal width in mm.
        #[schema(minimum = 0, maximum = 1000)]
        width_mm: f64,
        /// The speed of the fingers relative to each other, in mm/s.
        #[schema(minimum = 0, maximum = 10000)]
        speed_mm_s: f64,
        /// The force limit to set first, in N; it stays set. Where there is none, the limit that is set counts.
        #[schema(minimum = 0, maximum = 10000)]
        force_n: Option<f64>,
        /// The part's name, for the records. At most 48 bytes.
        #[schema(max_length = 48, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
        part_id: Option<String>,
    }
}

command_body! {
    /// A release.
    #[schema(example = json!({"width_mm": 60.0, "speed_mm_s": 100.0}))]
    Release {
        /// The opening width to open to, in mm.
        #[schema(minimum = 0, maximum = 1000)]
        width_mm: f64,
        /// The speed of the fingers relative to each other, in mm/s.
        #[schema(minimum = 0, maximum = 10000)]
        speed_mm_s: f64,
    }
}

command_body! {
    /// A stop.
    #[schema(example = json!({}))]
    Stop {}
}

/// Home the fingers
///
/// References the gripper at an end stop. It has to be done once after the device was switched on, and before any
/// other motion. Nothing may be in the way: an obstacle gives a wrong origin.
#[utoipa::path(
    post, path = "/grippers/{gripper}/home", operation_id = "home", tag = "motion",
    params(GripperPath, WaitQuery, KeyHeaders),
    request_body = Option<Home>,
    responses(Told, DeviceProblem)
)]
pub async fn home(gripper: Gripper, wait: Wait, keys: Keys, Body(body): Body<Home>) -> Result<Response, Problem> {
    let keys = body.keys(keys)?;
    answer(gripper, keys, Action::Motion(Motion::Home(body.direction.into())), wait).await
}

/// Move the fingers
///
/// A width or a speed beyond the device's limits is refused, though the device itself would clamp it; so is a target
/// that the soft limits forbid.
#[utoipa::path(
    post, path = "/grippers/{gripper}/move", operation_id = "move", tag = "motion",
    params(GripperPath, WaitQuery, KeyHeaders),
    request_body = Move,
    responses(Told, DeviceProblem)
)]
pub async fn move_fingers(
    gripper: Gripper,
    wait: Wait,
    keys: Keys,
    Body(body): Body<Move>,
) -> Result<Response, Problem> {
    let keys = body.keys(keys)?;
    let motion = Motion::Move {
        flags: MoveFlags { relative: body.relative, stop_on_block: body.on_block == OnBlock::Stop },
        width: width("width_mm", body.width_mm)?,
        speed: speed("speed_mm_s", body.speed_mm_s)?,
    };
    answer(gripper, keys, Action::Motion(motion), wait).await
}

/// Grip a part
///
/// Ends with `PART_HELD`, or with `NO_PART` where the fingers found none: that is an answer, not an error.
#[utoipa::path(
    post, path = "/grippers/{gripper}/grip", operation_id = "grip", tag = "motion",
    params(GripperPath, WaitQuery, KeyHeaders),
    request_body = Grip,
    responses(Told, DeviceProblem)
)]
pub async fn grip(gripper: Gripper, wait: Wait, keys: Keys, Body(body): Body<Grip>) -> Result<Response, Problem> {
    let keys = body.keys(keys)?;
    let motion = Motion::Grip {
        width: width("width_mm", body.width_mm)?,
        speed: speed("speed_mm_s", body.speed_mm_s)?,
        force: body.force_n.map(|n| force("force_n", n)).transpose()?,
        part_id: body.part_id.as_deref().map(|given| text("part_id", given)).transpose()?,
    };
    answer(gripper, keys, Action::Motion(motion), wait).await
}

/// Release a part
///
/// Opens the fingers to a width.
#[utoipa::path(
    post, path = "/grippers/{gripper}/release", operation_id = "release", tag = "motion",
    params(GripperPath, WaitQuery, KeyHeaders),
    request_body = Release,
    responses(Told, DeviceProblem)
)]
pub async fn release(gripper: Gripper, wait: Wait, keys: Keys, Body(body): Body<Release>) -> Result<Response, Problem> {
    let keys = body.keys(keys)?;
    let motion =
        Motion::Release { width: width("width_mm", body.width_mm)?, speed: speed("speed_mm_s", body.speed_mm_s)? };
    answer(gripper, keys, Action::Motion(motion), wait).await
}

/// Stop
///
/// Ends a running motion; its command ends with `ABORTED`. Needs no lease, and latches nothing. One that its client
/// repeats within a second, while there is nothing to stop, is the same command, `replayed`.
#[utoipa::path(
    post, path = "/grippers/{gripper}/stop", operation_id = "stop", tag = "motion",
    params(GripperPath, WaitQuery, KeyHeaders),
    request_body = Option<Stop>,
    responses(Told, DeviceProblem)
)]
pub async fn stop(gripper: Gripper, wait: Wait, keys: Keys, Body(body): Body<Stop>) -> Result<Response, Problem> {
    let keys = body.keys(keys)?;
    answer(gripper, keys, Action::Stop, wait).await
}

async fn answer(gripper: Gripper, keys: Keys, action: Action, wait: Wait) -> Result<Response, Problem> {
    commands::run(gripper, keys, action, wait).await.map(commands::told)
}
