//! Path of the client's own identity.

use super::paths;
use super::responses::AnyProblem;
use crate::operations::me::{self, Me};

paths! {
    /// Get my identity
    ///
    /// Returns who the client is to the gateway, what it may do with each gripper, and until when.
    #[utoipa::path(
        get, path = "/me", operation_id = "me", tag = "gateway",
        responses((status = 200, description = "The client's identity", body = Me), AnyProblem)
    )]
    me => me::ME;
}
