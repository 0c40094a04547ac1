//! The identity of a client.

use std::hash::{Hash, Hasher};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::ShownName;

/// Name that a lease holder gives itself.
pub type HolderName = ShownName<32>;

/// Interface through which a client reached the gateway.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "lowercase")]
pub enum Door {
    /// The HTTP API.
    Http,
    /// WebSocket.
    Ws,
    /// Zenoh.
    Zenoh,
    /// The WSG port, which speaks the device's own protocol.
    Wsg,
    /// Modbus TCP.
    Modbus,
    /// MQTT, through a broker.
    Mqtt,
}

impl Door {
    /// Whether motions from this interface take a free lease. The lease ends with the client's connection.
    #[must_use]
    pub const fn takes_lease_by_motion(self) -> bool {
        matches!(self, Self::Wsg | Self::Modbus)
    }

    /// Whether clients of this interface speak the device's own protocol. They expect a device that clamps values to its
    /// limits.
    #[must_use]
    pub const fn speaks_wsg(self) -> bool {
        matches!(self, Self::Wsg)
    }
}

/// Identity of a client, and the interface that it uses.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Client {
    /// Authenticated name; without credentials, the interface and the peer's address.
    pub subject: Arc<str>,
    pub door: Door,
    /// Label of a client without a credential. Clients are equal whatever their labels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<ClientLabel>,
}

/// Name by which a client without a credential calls its user. It helps people, proves nothing and gives no rights.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = ClientLabelField, value_type = String, max_length = 32)]
pub struct ClientLabel(Arc<str>);

impl Client {
    #[must_use]
    pub fn new(subject: impl Into<Arc<str>>, door: Door) -> Self {
        Self { subject: subject.into(), door, label: None }
    }
}

impl PartialEq for Client {
    fn eq(&self, other: &Self) -> bool {
        self.subject == other.subject && self.door == other.door
    }
}

impl Eq for Client {}

impl Hash for Client {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (&self.subject, self.door).hash(state);
    }
}

impl ClientLabel {
    /// Returns `None` if the text is empty, or not allowed as the name of a lease holder.
    #[must_use]
    pub fn new(text: &str) -> Option<Self> {
        let name = HolderName::new(text.trim()).ok()?;
        (!name.as_str().is_empty()).then(|| Self(name.as_str().into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn label_follows_the_rules_of_holder_names() {
        let label = |text| ClientLabel::new(text).map(|label| label.0.to_string());
        assert_eq!(label(" Anna M\u{fc}ller "), Some("Anna M\u{fc}ller".to_owned()));
        for refused in ["", "  ", "a\nb", "\u{202E}annA", "r\u{43E}bot", &"x".repeat(33)] {
            assert_eq!(label(refused), None, "{refused:?}");
        }
    }

    #[test]
    fn label_makes_no_other_client() {
        let client = Client::new("http:10.0.0.5", Door::Http);
        let labelled = Client { label: ClientLabel::new("Anna"), ..client.clone() };
        assert!(labelled.label.is_some() && labelled == client);
    }
}
