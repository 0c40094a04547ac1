//! Paths that look up and cancel commands.

use super::parameters::CommandReply;
use super::parameters::{CommandPath, GripperPath, KeyHeaders, LatestQuery, LeaseHeader, NoWaitQuery, WaitQuery};
use super::paths;
use super::responses::CommandProblem;
use crate::gripper::model::CommandReport;
use crate::operations::Leased;
use crate::operations::commands;

paths! {
    /// Get a command
    ///
    /// Waits up to `wait_ms` for the command to end, then returns it, ended or not.
    #[utoipa::path(
        get,
        path = "/grippers/{gripper}/commands/{command}",
        operation_id = "get_command",
        tag = "commands",
        params(GripperPath, CommandPath, NoWaitQuery, LeaseHeader),
        responses((status = 200, description = "The command", body = CommandReport), CommandProblem)
    )]
    get => commands::GET;
    /// Get the newest command
    ///
    /// Returns the newest motion of the gripper. With `request_id`, returns the newest command of this client with that
    /// id, which can also be a Stop. Waits up to `wait_ms` for the command to end.
    #[utoipa::path(
        get,
        path = "/grippers/{gripper}/commands/latest",
        operation_id = "get_latest_command",
        tag = "commands",
        params(GripperPath, LatestQuery, NoWaitQuery, KeyHeaders),
        responses((status = 200, description = "The command", body = CommandReport), CommandProblem)
    )]
    latest => commands::LATEST;
    /// Cancel a command
    ///
    /// Stops the command if it is still running. A command that has ended is returned unchanged.
    #[utoipa::path(
        post,
        path = "/grippers/{gripper}/commands/{command}/cancel",
        operation_id = "cancel_command",
        tag = "commands",
        params(GripperPath, CommandPath, WaitQuery, LeaseHeader),
        request_body(content = Option<Leased>, description = "The lease token; optional"),
        responses(CommandReply, CommandProblem)
    )]
    cancel => commands::CANCEL;
}
