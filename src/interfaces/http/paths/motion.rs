//! Home, move, grip, release, stop.

use super::parameters::CommandReply;
use super::parameters::{GripperPath, KeyHeaders, WaitQuery};
use super::paths;
use super::responses::DeviceProblem;
use crate::operations::motion::{self, Grip, Home, Move, Release, Stop};

paths! {
    /// Home the fingers
    ///
    /// References the gripper at an end stop. It has to be done once after the device was switched on, and before any
    /// other motion. Nothing may be in the way: an obstacle gives a wrong origin.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/home", operation_id = "home", tag = "motion",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Option<Home>,
        responses(CommandReply, DeviceProblem)
    )]
    home => motion::HOME;
    /// Move the fingers
    ///
    /// A width or a speed beyond the device's limits is refused, though the device itself would clamp it; so is a target
    /// that the soft limits forbid.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/move", operation_id = "move", tag = "motion",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Move,
        responses(CommandReply, DeviceProblem)
    )]
    move_fingers => motion::MOVE;
    /// Grip a part
    ///
    /// Ends with `PART_HELD`, or with `NO_PART` where the fingers found none: that is an answer, not an error.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/grip", operation_id = "grip", tag = "motion",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Grip,
        responses(CommandReply, DeviceProblem)
    )]
    grip => motion::GRIP;
    /// Release a part
    ///
    /// Opens the fingers to a width.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/release", operation_id = "release", tag = "motion",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Release,
        responses(CommandReply, DeviceProblem)
    )]
    release => motion::RELEASE;
    /// Stop
    ///
    /// Ends a running motion; its command ends with `ABORTED`. Needs no lease, and latches nothing. One that its client
    /// repeats within a second, while there is nothing to stop, is the same command, `replayed`.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/stop", operation_id = "stop", tag = "motion",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Option<Stop>,
        responses(CommandReply, DeviceProblem)
    )]
    stop => motion::STOP;
}
