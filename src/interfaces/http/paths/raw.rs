//! Path of raw requests in the device's own protocol.

use super::parameters::{GripperPath, KeyHeaders, WaitQuery};
use super::paths;
use super::responses::DeviceProblem;
use crate::gripper::model::CommandReport;
use crate::operations::raw::{self, Raw, RawAnswer};

paths! {
    /// Send a raw request
    ///
    /// Ids from the manuals take the same path as the typed operations, with the same checks. 07h, 24h and automatic
    /// updates are reserved for the gateway and are refused.
    ///
    /// Other ids are custom commands. They count as motions and are recorded as motions, unless the configuration lists
    /// them in `read_ids`. Ids in `stream_ids` are motions that come many times a second: they skip the pause between
    /// motions, and the journal counts them each second instead of recording every one.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/raw", operation_id = "raw", tag = "device",
        params(GripperPath, WaitQuery, KeyHeaders),
        request_body = Raw,
        responses(
            (status = 200, description = "The device's reply", body = RawAnswer),
            (status = 202, description = "The command, still running after `wait_ms`", body = CommandReport,
                headers(("Location" = String, description = "Path of the command"))),
            DeviceProblem,
        )
    )]
    raw => raw::RAW;
}
