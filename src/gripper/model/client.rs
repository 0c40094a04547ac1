//! Who asks, and through which door.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The way in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Door {
    /// REST.
    Http,
    /// WebSocket.
    Ws,
    /// Zenoh.
    Zenoh,
    /// The device's own protocol.
    Wsg,
}

impl Door {
    /// Whether its clients speak the device's own protocol: none of them brings a lease, so what moves takes it where it
    /// is free; and they are used to a device that clamps what is beyond its limits.
    #[must_use]
    pub const fn speaks_wsg(self) -> bool {
        matches!(self, Self::Wsg)
    }
}

/// The identity behind a client, and the interface that it uses.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Client {
    /// Before there are credentials, the door and the peer's address.
    pub subject: Arc<str>,
    /// The door.
    pub door: Door,
}
