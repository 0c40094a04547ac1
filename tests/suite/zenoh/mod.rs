//! The Zenoh interface, with clients on a network of their own.

mod commands;
mod fleet;
mod leases;
mod names;
mod outages;
mod publications;
mod recipes;
pub mod router;
mod stalled;
mod tls;

use std::time::Duration;

use crate::harness::{Gateway, Proxy, Simulator, ZenohClient};

/// Time that other tests on the machine may add.
const BUSY_MARGIN: Duration = Duration::from_secs(1);

/// A connected gripper `g` behind a recording proxy, and a client.
struct Rig {
    _device: Simulator,
    proxy: Proxy,
    gateway: Gateway,
    client: ZenohClient,
}

impl Rig {
    async fn start(options: &[&str]) -> Self {
        let device = Simulator::start(options).await;
        let proxy = Proxy::to(device.address);
        let gateway = Gateway::connected_to(proxy.address).await;
        let client = ZenohClient::of(&gateway).await;
        Self { _device: device, proxy, gateway, client }
    }
}
