//! The lease: who may move the gripper.

use super::parameters::{GripperPath, LeaseHeader};
use super::paths;
use super::responses::{CommandProblem, LeaseProblem};
use crate::gripper::model::Lease;
use crate::operations::Leased;
use crate::operations::lease::{self, HandOver, Take};

paths! {
    /// The lease
    ///
    /// Who holds it, and for how long. While nobody does, anybody may move the gripper, one command at a time.
    #[utoipa::path(
        get, path = "/grippers/{gripper}/lease", operation_id = "get_lease", tag = "lease",
        params(GripperPath, LeaseHeader),
        responses((status = 200, description = "The lease, without its token", body = Lease), CommandProblem)
    )]
    get => lease::GET;
    /// Take the lease
    ///
    /// Its token goes with each command from now on, and each use renews the lease; an open request keeps it. A holder that
    /// is not heard from for `ttl_ms` is lost: what becomes of the gripper then is said here.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/lease", operation_id = "take_lease", tag = "lease",
        params(GripperPath, LeaseHeader),
        request_body = Option<Take>,
        responses((status = 200, description = "The lease, with its token", body = Lease), LeaseProblem)
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
    /// A running motion stops, and nothing is latched. What isn't its caller's any more stays as it is.
    #[utoipa::path(
        delete, path = "/grippers/{gripper}/lease", operation_id = "release_lease", tag = "lease",
        params(GripperPath, LeaseHeader),
        request_body = Option<Leased>,
        responses((status = 200, description = "The lease as it is now", body = Lease), CommandProblem)
    )]
    release => lease::RELEASE;
    /// Hand the lease over
    ///
    /// To who has asked for it, and gets a token of its own when it asks again. A running motion goes on.
    #[utoipa::path(
        post, path = "/grippers/{gripper}/lease/hand-over", operation_id = "hand_over_lease", tag = "lease",
        params(GripperPath, LeaseHeader),
        request_body = HandOver,
        responses((status = 200, description = "The lease as it is now", body = Lease), LeaseProblem)
    )]
    hand_over => lease::HAND_OVER;
}
