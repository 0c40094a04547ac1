//! Path of the mounted finger set.

use super::parameters::GripperPath;
use super::paths;
use super::responses::{GripperProblem, KnowledgeProblem};
use crate::operations::finger_set::{self, FingerSetAnswer, SetFingerSet};

paths! {
    /// Get the finger set
    ///
    /// Returns the mounted finger set, and its use since it was mounted.
    #[utoipa::path(
        get, path = "/grippers/{gripper}/finger-set", operation_id = "get_finger_set", tag = "grippers",
        params(GripperPath),
        responses((status = 200, description = "The finger set", body = FingerSetAnswer), GripperProblem)
    )]
    get => finger_set::GET;
    /// Set the finger set
    ///
    /// Notes the mounted finger set and its maintenance limits. Nothing is sent to the device. With another id, counting
    /// starts from zero; with the same id only if `reset` is set.
    #[utoipa::path(
        put, path = "/grippers/{gripper}/finger-set", operation_id = "set_finger_set", tag = "grippers",
        params(GripperPath),
        request_body = SetFingerSet,
        responses((status = 200, description = "The finger set", body = FingerSetAnswer), KnowledgeProblem)
    )]
    set => finger_set::SET;
}
