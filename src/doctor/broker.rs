//! Check of the MQTT broker: whether it accepts the gateway.

use super::{Diagnosis, Installation};
use crate::interfaces::mqtt;

/// Opens a connection of its own, beside those of a running gateway.
pub(super) async fn check(installation: &Installation) -> Option<Diagnosis> {
    let settings = installation.config.mqtt.as_ref()?;
    let broker = &settings.broker;
    Some(match mqtt::check(settings).await {
        Ok(()) => Diagnosis::good("mqtt", format_args!("{broker} accepts the gateway")),
        Err(error) => Diagnosis::problem("mqtt", format_args!("{broker}: {error}")),
    })
}
