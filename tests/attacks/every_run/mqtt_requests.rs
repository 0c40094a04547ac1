//! A flood of requests through a broker.

use crate::attack::{self, MANY};
use crate::device::Device;
use crate::gateway::{Gateway, Limits};

#[test]
fn flood_of_mqtt_requests_blocks_no_client() {
    let g = Device::start();
    let h = Device::start();
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let mqtt = gateway.mqtt.as_ref().unwrap();
    attack::run("10,000 MQTT requests a second", MANY, (&gateway, &g), || mqtt.flood(), |_, _| {}).blocks_no_client();
}
