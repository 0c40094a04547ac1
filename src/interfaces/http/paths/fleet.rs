//! Paths of the fleet: the grippers of all gateways.

use super::paths;
use super::responses::{AnyProblem, CommandProblem, CopyProblem, FastStopsProblem};
use crate::operations::copy_recipes::{self, CopyRecipes, RecipesCopied};
use crate::operations::fast_stop::FastStopBody;
use crate::operations::fleet::{self, FleetAcknowledge, FleetAcknowledged, FleetFastStopAnswer, FleetList};

paths! {
    /// List the fleet
    ///
    /// Lists all grippers of all gateways on the Zenoh network, including this gateway's own. A gateway that vanishes
    /// is marked `gone` within 2 s. Each gripper operation is also available below
    /// `/fleet/{gateway}/grippers/{gripper}/…`, with the same fields, responses and problems. The gateway that owns the
    /// gripper decides.
    ///
    /// `gateway_gone` means that nothing was sent to that gateway. `gateway_timeout` means that the outcome is unknown:
    /// repeat the request with the same `request_id`.
    #[utoipa::path(
        get, path = "/fleet", operation_id = "fleet", tag = "fleet",
        responses((status = 200, description = "All grippers of all gateways", body = FleetList), AnyProblem)
    )]
    list => fleet::LIST;
}

paths! {
    /// FAST STOP the fleet
    ///
    /// Sends a FAST STOP to all grippers of all gateways. The response comes once all grippers of live gateways have
    /// confirmed it, or after 500 ms. FAST STOP is not a safety function in the sense of ISO 13850.
    #[utoipa::path(
        post, path = "/fleet/fast-stop", operation_id = "fleet_fast_stop", tag = "fleet",
        request_body = Option<FastStopBody>,
        responses((status = 200, description = "The FAST STOP was sent to the fleet", body = FleetFastStopAnswer), FastStopsProblem)
    )]
    fast_stop => fleet::FAST_STOP;
}

paths! {
    /// Acknowledge FAST STOPs of the fleet
    ///
    /// Acknowledges each gripper of any gateway whose latched FAST STOP is named. A gripper that cannot be acknowledged
    /// has a problem, and does not prevent the others. Acknowledging moves nothing.
    #[utoipa::path(
        post, path = "/fleet/acknowledge", operation_id = "fleet_acknowledge", tag = "fleet",
        request_body = FleetAcknowledge,
        responses((status = 200, description = "The acknowledgements were sent", body = FleetAcknowledged), CommandProblem)
    )]
    acknowledge => fleet::ACKNOWLEDGE;
}

paths! {
    /// Copy recipes to another gateway
    ///
    /// Sets recipes of this gateway on another one: all that are named, or none if it refuses one, e.g. because a number
    /// belongs to another part there. Its further recipes stay as they are. The two gateways do not follow each other's
    /// later changes.
    #[utoipa::path(
        post, path = "/fleet/copy-recipes", operation_id = "copy_recipes", tag = "recipes",
        request_body = CopyRecipes,
        responses((status = 200, description = "The other gateway has the recipes", body = RecipesCopied), CopyProblem)
    )]
    copy_recipes => copy_recipes::COPY;
}
