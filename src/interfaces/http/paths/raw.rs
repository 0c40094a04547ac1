//! A request of the device's own protocol.

use super::parameters::{GripperPath, KeyHeaders, WaitQuery};
use super::paths;
use super::responses::DeviceProblem;
use crate::gripper::model::Command;
use crate::operations::raw::{self, Raw, RawAnswer};

paths! {
    /// A raw request
    ///
    /// Ids that the manuals know take the same path as the other operations, with the same checks; 07h, 24h and automatic
    /// updates are the gateway's own, and refused. Other ids are custom commands: they count as motions, and are written
    /// down as such, unless the configuration has them among its `read_ids`. Those among its `stream_ids` are motions that
    /// come many times a second: they wait for no pause, and are counted in the journal by the second.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/raw", operation_id = "raw", tag = "device",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Raw,
        responses(
            (status = 200, description = "The device's answer", body = RawAnswer),
            (status = 202, description = "The command, still running after `wait_ms`", body = Command,
                headers(("Location" = String, description = "Where to ask for it"))),
            DeviceProblem,
        )
    )]
    raw => raw::RAW;
}
