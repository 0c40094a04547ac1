//! Paths of the motions: home, move, grip, release, stop.

use super::parameters::CommandReply;
use super::parameters::{GripperPath, KeyHeaders, WaitQuery};
use super::paths;
use super::responses::{DeviceProblem, RecipeMotionProblem};
use crate::operations::motion::{self, Grip, Home, Move, Release, Stop};

paths! {
    /// Home the fingers
    ///
    /// References the gripper at an end stop. Required once after the device was switched on, before any other motion.
    /// Keep the path of the fingers clear: an obstacle gives a wrong origin.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/home", operation_id = "home", tag = "motion",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Option<Home>,
        responses(CommandReply, DeviceProblem)
    )]
    home => motion::HOME;
    /// Move the fingers
    ///
    /// The gateway refuses a width or speed beyond the device's limits, which the device itself would clamp. It also
    /// refuses a target outside the soft limits.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/move", operation_id = "move", tag = "motion",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Move,
        responses(CommandReply, DeviceProblem)
    )]
    move_fingers => motion::MOVE;
    /// Grip a part
    ///
    /// Ends with `PART_HELD`, or with `NO_PART` if the fingers found no part. `NO_PART` is a result, not an error.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/grip", operation_id = "grip", tag = "motion",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Grip,
        responses(CommandReply, RecipeMotionProblem)
    )]
    grip => motion::GRIP;
    /// Release a part
    ///
    /// Opens the fingers to `width_mm`.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/release", operation_id = "release", tag = "motion",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Release,
        responses(CommandReply, RecipeMotionProblem)
    )]
    release => motion::RELEASE;
    /// Stop
    ///
    /// Ends a running motion, whose command ends with `ABORTED`. Needs no lease and latches nothing. A stop that the
    /// same client repeats within a second, while nothing runs, returns the same command with `replayed`. A malformed
    /// body stops as well.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/stop", operation_id = "stop", tag = "motion",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Option<Stop>,
        responses(CommandReply, DeviceProblem)
    )]
    stop => motion::STOP;
}
