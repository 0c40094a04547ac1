//! The identity of a client.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Interface through which a client reached the gateway.
///
/// - `http`: the HTTP API
/// - `ws`: WebSocket
/// - `zenoh`: Zenoh
/// - `wsg`: the WSG port, which speaks the device's own protocol
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Door {
    Http,
    Ws,
    Zenoh,
    Wsg,
}

impl Door {
    /// Whether clients of this interface speak the device's own protocol. They can't take a lease themselves, so their
    /// motions take a free lease implicitly. They also expect a device that clamps values to its limits.
    #[must_use]
    pub const fn speaks_wsg(self) -> bool {
        matches!(self, Self::Wsg)
    }
}

/// Identity of a client, and the interface that it uses.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Client {
    /// Authenticated name; without credentials, the interface and the peer's address.
    pub subject: Arc<str>,
    pub door: Door,
}
