//! Path that reads the configuration again.

use super::paths;
use super::responses::ReloadProblem;
use crate::operations::reload::{self, Reloaded};

paths! {
    /// Reload the configuration
    ///
    /// Reads the configuration file again and applies what has changed: grippers, WSG ports, the address, credentials,
    /// certificates and limits. Grippers with the same configuration are not touched. If anything cannot be used,
    /// nothing changes.
    #[utoipa::path(
        post, path = "/reload", operation_id = "reload", tag = "gateway",
        responses((status = 200, description = "The new configuration is in use", body = Reloaded), ReloadProblem)
    )]
    reload => reload::RELOAD;
}
