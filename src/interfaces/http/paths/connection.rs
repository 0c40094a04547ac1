//! Paths that release a gripper to another program, and connect to it again.

use super::parameters::{GripperPath, LeaseHeader};
use super::paths;
use super::responses::DeviceProblem;
use crate::gripper::model::State;
use crate::operations::{Leased, connection};

paths! {
    /// Release a gripper to another program
    ///
    /// Announces the disconnect to the device and closes the link, so that another program, such as the vendor's tool,
    /// can connect. The state `link` is `released` until a `connect` request or a restart of the gateway. Refused while
    /// the fingers move.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/disconnect", operation_id = "disconnect", tag = "device",
        params(GripperPath, LeaseHeader),
        request_body(content = Option<Leased>, description = "The lease token; optional"),
        responses((status = 200, description = "The state after the link was closed", body = State), DeviceProblem)
    )]
    disconnect => connection::DISCONNECT;
    /// Connect to a released gripper
    ///
    /// Lets the gateway connect to the device again. Returns at once; `link` shows when the link is connected. A FAST
    /// STOP that was latched while the gripper was released is sent first.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/connect", operation_id = "connect", tag = "device",
        params(GripperPath, LeaseHeader),
        request_body(content = Option<Leased>, description = "The lease token; optional"),
        responses((status = 200, description = "The state; the link is not connected yet", body = State), DeviceProblem)
    )]
    connect => connection::CONNECT;
}
