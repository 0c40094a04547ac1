//! MQTT of a real gateway.

#[allow(dead_code, reason = "parts used only by attacks")]
mod broker;
mod misbehaving;
mod publications;
mod requests;

use serde_json::json;

use crate::harness::Gateway;
use broker::Broker;

/// Returns a configuration with one gripper and MQTT, with more lines for it.
fn configuration(broker: &Broker, lines: &str) -> String {
    format!(
        "[grippers.g]\nurl = \"sim://wsg50?part_mm=20\"\n[mqtt]\nbroker = \"mqtt://{}\"\nprefix = \"plant/cell\"\n{lines}\n",
        broker.address
    )
}

/// Starts a gateway with one gripper, which is homed.
async fn homed(broker: &Broker, arguments: &[&str], lines: &str) -> Gateway {
    let gateway = Gateway::with_file(arguments, &configuration(broker, lines)).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    gateway
}
