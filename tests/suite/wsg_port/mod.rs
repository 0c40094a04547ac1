//! The WSG port, with stand-ins for real drivers.

mod allowed;
mod disconnects;
mod drivers;
mod field_notes;
mod latch;
mod limits;
mod link;
mod malformed;
mod manual;
mod replays;
mod steering;
mod streams;
mod together;
mod udp;

use std::net::SocketAddr;

use crate::harness::wsg::Driver;
use crate::harness::{Gateway, Proxy, Simulator};

const SUCCESS: u16 = 0;
const NOT_INITIALIZED: u16 = 3;
const ALREADY_RUNNING: u16 = 4;
const CHECKSUM_ERROR: u16 = 11;
const FORMAT_ERROR: u16 = 15;
const ACCESS_DENIED: u16 = 16;
const CMD_FAILED: u16 = 18;
const ABORTED: u16 = 19;
const IO_ERROR: u16 = 23;
const OVERRUN: u16 = 27;
const RANGE_ERROR: u16 = 28;

const MOVE: u8 = 0x21;
const GRIP: u8 = 0x25;

/// A gripper with a part of 20 mm, behind a gateway with a WSG port.
struct Cell {
    _device: Simulator,
    proxy: Proxy,
    gateway: Gateway,
    port: SocketAddr,
}

impl Cell {
    async fn new() -> Self {
        Self::with(&[]).await
    }

    async fn with(arguments: &[&str]) -> Self {
        let device = Simulator::with_part().await;
        let proxy = Proxy::to(device.address);
        let (gateway, port) = Gateway::with_port(proxy.address, arguments).await;
        Self { _device: device, proxy, gateway, port }
    }

    /// A cell whose gripper was homed over HTTP.
    async fn homed() -> Self {
        let cell = Self::new().await;
        cell.home().await;
        cell
    }

    async fn home(&self) {
        self.gateway.post("home", &serde_json::json!({})).await.outcome("SUCCESS");
    }

    async fn driver(&self) -> Driver {
        Driver::connect(self.port).await
    }
}

/// Starts a gateway with this configuration, and waits for the link.
async fn configured(text: &str) -> Gateway {
    let gateway = Gateway::with_file(&[], text).await;
    gateway.until_link("connected").await;
    gateway
}

/// Connects a driver to the gateway's WSG port.
async fn connect(gateway: &Gateway) -> Driver {
    Driver::connect(gateway.word_after("WSG port of g: tcp://").await.parse().unwrap()).await
}
