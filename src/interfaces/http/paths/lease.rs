//! Paths of the lease, the right to move a gripper.

use super::parameters::{GripperPath, LeaseHeader};
use super::paths;
use super::responses::{CommandProblem, LeaseProblem};
use crate::gripper::model::Lease;
use crate::operations::Leased;
use crate::operations::lease::{self, HandOver, Take};

paths! {
    /// Get the lease
    ///
    /// Returns the lease holder and the remaining time. While nobody holds the lease, any client may move the gripper,
    /// one command at a time.
    #[utoipa::path(
        get, path = "/grippers/{gripper}/lease", operation_id = "get_lease", tag = "lease",
        params(GripperPath, LeaseHeader),
        responses((status = 200, description = "The lease, without its token", body = Lease), CommandProblem)
    )]
    get => lease::GET;
    /// Take the lease
    ///
    /// Returns a token; send it with every further command. Each use of the token renews the lease, and an open request
    /// with it keeps the lease alive. A holder that stays silent for `ttl_ms` counts as lost; `on_loss_moving` and
    /// `on_loss_holding` say what the gripper does then.
    ///
    /// A client that has lost its token gets its lease back with the same `holder` and the same credential or address.
    /// This is refused until the lease has not been used for half its time to live, while a motion runs, while a part
    /// is held and `on_loss_holding` is `fast_stop`, and while a request or connection of the holder is open.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/lease", operation_id = "take_lease", tag = "lease",
        params(GripperPath, LeaseHeader),
        request_body = Option<Take>,
        responses(
            (status = 200, description = "The lease, with its token", body = Lease),
            (status = 202, description = "The hand-over is requested: the current lease, with the `place` of the request", body = Lease),
            LeaseProblem
        )
    )]
    take => lease::TAKE;
    /// Renew the lease
    #[utoipa::path(
        put, path = "/grippers/{gripper}/lease", operation_id = "renew_lease", tag = "lease",
        params(GripperPath, LeaseHeader),
        request_body = Option<Leased>,
        responses((status = 200, description = "The lease, renewed", body = Lease), LeaseProblem)
    )]
    renew => lease::RENEW;
    /// Release the lease
    ///
    /// Stops a running motion and latches nothing. A lease that the caller no longer holds is left unchanged.
    #[utoipa::path(
        delete, path = "/grippers/{gripper}/lease", operation_id = "release_lease", tag = "lease",
        params(GripperPath, LeaseHeader),
        request_body = Option<Leased>,
        responses((status = 200, description = "The current lease", body = Lease), CommandProblem)
    )]
    release => lease::RELEASE;
    /// Hand the lease over
    ///
    /// Passes the lease to the client in `requested_by`, which gets its own token when it requests the lease again. A
    /// running motion continues.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/lease/hand-over", operation_id = "hand_over_lease", tag = "lease",
        params(GripperPath, LeaseHeader),
        request_body = HandOver,
        responses((status = 200, description = "The current lease", body = Lease), LeaseProblem)
    )]
    hand_over => lease::HAND_OVER;
}
