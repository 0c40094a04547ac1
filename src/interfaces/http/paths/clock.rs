//! Path of the gateway's clock.

use super::paths;
use super::responses::AnyProblem;
use crate::operations::clock::{self, GatewayClock};

paths! {
    /// Get the gateway's clock
    ///
    /// Returns the times at which the gateway received the request and answered it. A client that notes its own times
    /// of sending and receiving can estimate its offset to the gateway, as with NTP.
    #[utoipa::path(
        get, path = "/clock", operation_id = "clock", tag = "gateway",
        responses((status = 200, description = "The gateway's times", body = GatewayClock), AnyProblem)
    )]
    clock => clock::CLOCK;
}
