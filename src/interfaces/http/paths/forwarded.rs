//! OpenAPI description of the paths below a gripper of the fleet, which forward any operation below
//! `/grippers/{gripper}`.

use utoipa::{IntoParams, OpenApi};

use super::parameters::KeyHeaders;
use super::responses::DeviceProblem;
use crate::operations::Members;

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "only describes the path's parameters")]
struct ForwardedPath {
    /// Name of the gateway that owns the gripper.
    #[param(min_length = 1, max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "gateway")]
    gateway: String,
    /// The gripper's name on that gateway.
    #[param(min_length = 1, max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "left")]
    gripper: String,
    /// The rest of the operation's path after the gripper, slashes included: `state`, `move`, `settings/acceleration`.
    #[param(min_length = 1, max_length = 64, pattern = "^[a-z0-9-]{1,64}(/[a-z0-9-]{1,64})*$", example = "state")]
    operation: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only describes the query")]
struct ForwardedQuery {
    /// Maximum wait in ms, within the operation's own limits. Ignored by operations without this parameter.
    #[param(example = "5000")]
    wait_ms: Option<String>,
}

macro_rules! forwarded {
    ($($(#[$doc:meta])* $name:ident: $verb:ident $id:literal $(, $body:ident = $of:ty)?;)*) => {
        $(
            $(#[$doc])*
            #[utoipa::path(
                $verb, path = "/api/v1/fleet/{gateway}/grippers/{gripper}/{operation}", operation_id = $id, tag = "fleet",
                params(ForwardedPath, ForwardedQuery, KeyHeaders),
                $($body = $of,)?
                responses(
                    (status = 200, description = "The operation's own response", body = Value),
                    (status = 202, description = "The operation's own response while a command runs", body = Value,
                        headers(("Location" = String, description = "Path of the command"))),
                    (status = 405, description = "`method_not_allowed`: see the Allow header for the operation's methods",
                        body = Members, content_type = "application/problem+json"),
                    DeviceProblem,
                )
            )]
            #[allow(dead_code, reason = "only describes what `forward` serves")]
            fn $name() {}
        )*

        /// The OpenAPI document of all forwarded paths.
        #[derive(OpenApi)]
        #[openapi(paths($($name),*))]
        pub struct Forwarded;
    };
}

forwarded! {
    /// Read from a gripper of the fleet
    ///
    /// Performs any GET below `/grippers/{gripper}` on a gripper of any gateway, with the same parameters, responses
    /// and problems.
    get: get "fleet_get";
    /// Command a gripper of the fleet
    ///
    /// Performs any POST below `/grippers/{gripper}` on a gripper of any gateway, with the same fields, responses and
    /// problems. The gateway that owns the gripper decides. The lease does not expire while the request is open.
    post: post "fleet_post", request_body = Option<Value>;
    /// Change a setting of a gripper of the fleet
    ///
    /// Performs any PUT below `/grippers/{gripper}` on a gripper of any gateway, with the same fields, responses and
    /// problems.
    put: put "fleet_put", request_body = Option<Value>;
    /// Clear a setting of a gripper of the fleet
    ///
    /// Performs any DELETE below `/grippers/{gripper}` on a gripper of any gateway, with the same fields, responses and
    /// problems.
    delete: delete "fleet_delete", request_body = Option<Value>;
}
