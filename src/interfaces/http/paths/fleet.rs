//! The grippers of all gateways.

use super::paths;
use super::responses::AnyProblem;
use crate::operations::fast_stop::FastStopBody;
use crate::operations::fleet::{self, FleetFastStopAnswer, FleetList};

paths! {
    /// The fleet
    ///
    /// All grippers of all gateways on the Zenoh network, its own among them. `gone` says that a gateway has vanished, within
    /// 2 s. Each operation on a gripper is there as `/fleet/{gateway}/grippers/{gripper}/…`, too, with the same fields,
    /// answers and problems: the gateway that owns the gripper decides. `gateway_gone` says that nothing was sent there, and
    /// `gateway_timeout` that nobody knows whether it was done: ask again with the same `request_id`.
    #[utoipa::path(
        get, path = "/fleet", operation_id = "fleet", tag = "fleet",
        responses((status = 200, description = "All grippers of all gateways", body = FleetList), AnyProblem)
    )]
    list => fleet::LIST;
}

paths! {
    /// FAST STOP of the fleet
    ///
    /// Stops all grippers of all gateways. Answers once all whose gateways live have confirmed, or after 500 ms. It is not a safety
    /// function in the sense of ISO 13850.
    #[utoipa::path(
        post, path = "/fleet/fast-stop", operation_id = "fleet_fast_stop", tag = "fleet",
        request_body = Option<FastStopBody>,
        responses((status = 200, description = "All are told", body = FleetFastStopAnswer), AnyProblem)
    )]
    fast_stop => fleet::FAST_STOP;
}
