//! What the document says of the paths below a gripper of the fleet: each is any operation below `/grippers/{gripper}`.

use utoipa::{IntoParams, OpenApi};

use super::parameters::KeyHeaders;
use super::responses::DeviceProblem;
use crate::operations::Members;

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "the document's words on what the path names")]
struct ForwardedPath {
    /// The gateway that owns the gripper.
    #[param(min_length = 1, max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "gateway")]
    gateway: String,
    /// The gripper's name there.
    #[param(min_length = 1, max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "left")]
    gripper: String,
    /// What follows the gripper in the operation's own path, slashes among it: `state`, `move`, `settings/acceleration`.
    #[param(min_length = 1, max_length = 64, pattern = "^[a-z0-9-]{1,64}(/[a-z0-9-]{1,64})*$", example = "state")]
    operation: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "the document's words on what the query may have")]
struct ForwardedQuery {
    /// How long to wait, in ms, where the operation has such a parameter: within its own limits. Others don't look at it.
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
                    (status = 200, description = "The operation's own answer", body = Value),
                    (status = 202, description = "The operation's own answer, while a command runs", body = Value,
                        headers(("Location" = String, description = "Where to ask for it"))),
                    (status = 405, description = "`method_not_allowed`: the operation has other methods, which Allow lists",
                        body = Members, content_type = "application/problem+json"),
                    DeviceProblem,
                )
            )]
            #[allow(dead_code, reason = "the document's words on what fleet::forward serves")]
            fn $name() {}
        )*

        /// All of them.
        #[derive(OpenApi)]
        #[openapi(paths($($name),*))]
        pub struct Forwarded;
    };
}

forwarded! {
    /// Read of a gripper of the fleet
    ///
    /// Any GET below `/grippers/{gripper}`, of a gripper of any gateway: with its parameters, answers and problems.
    get: get "fleet_get";
    /// Command a gripper of the fleet
    ///
    /// Any POST below `/grippers/{gripper}`, of a gripper of any gateway, which decides: with its fields, answers and
    /// problems. While the request is open, the lease doesn't run out.
    post: post "fleet_post", request_body = Option<Value>;
    /// Set something of a gripper of the fleet
    ///
    /// Any PUT below `/grippers/{gripper}`, of a gripper of any gateway: with its fields, answers and problems.
    put: put "fleet_put", request_body = Option<Value>;
    /// Clear something of a gripper of the fleet
    ///
    /// Any DELETE below `/grippers/{gripper}`, of a gripper of any gateway: with its fields, answers and problems.
    delete: delete "fleet_delete", request_body = Option<Value>;
}
