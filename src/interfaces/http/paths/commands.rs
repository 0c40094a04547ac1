//! Commands: looked up, cancelled.

use super::parameters::CommandReply;
use super::parameters::{CommandPath, GripperPath, LeaseHeader, NoWaitQuery, WaitQuery};
use super::paths;
use super::responses::CommandProblem;
use crate::gripper::model::Command;
use crate::operations::Leased;
use crate::operations::commands;

paths! {
    /// A command
    ///
    /// As it is now, or when it has ended, if that is sooner than `wait_ms`.
    #[utoipa::path(
        get,
        path = "/grippers/{gripper}/commands/{command}",
        operation_id = "get_command",
        tag = "commands",
        params(GripperPath, CommandPath, NoWaitQuery, LeaseHeader),
        responses((status = 200, description = "The command", body = Command), CommandProblem)
    )]
    get => commands::GET;
    /// Cancel a command
    ///
    /// Stops it if it still runs; one that has ended stays as it is.
    #[utoipa::path(
        post,
        path = "/grippers/{gripper}/commands/{command}/cancel",
        operation_id = "cancel_command",
        tag = "commands",
        params(GripperPath, CommandPath, WaitQuery, LeaseHeader),
        request_body(content = Option<Leased>, description = "Nothing, or the lease's token"),
        responses(CommandReply, CommandProblem)
    )]
    cancel => commands::CANCEL;
}
