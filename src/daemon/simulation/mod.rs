//! Simulated devices in real time: over a pipe in this process for `sim://`, over every transport for `wsg-gateway
//! sim`.
//!
//! A `wire` is the device's end of a transport. The `pump` runs a device over it, controlled by a [`Switch`].
//! `control` serves the switches of all devices over HTTP.

mod control;
mod pty;
mod pump;
mod serve;
mod udp;
mod wire;

use std::future::Future;
use std::io;
use std::pin::Pin;
use std::time::Duration;

use tokio::sync::mpsc;
use url::Url;

use crate::gripper::Connector;
use crate::model::clock;
use crate::sim::{Device, DeviceConfig};
use crate::transport::{Address, LinkProperties, Pipe};
pub use pump::Switch;
pub use serve::{serve, serve_simulated};
use wire::Wire;

/// Capacity of a pipe in this process, in bytes and each direction: about what a socket would hold of small frames.
const PIPE_BYTES: usize = 4096;

/// Names of the models in URLs.
const MODELS: &str = "wsg25, wsg32, wsg50, wsg70";

/// Properties of a pipe in this process, which stands for a device on TCP.
const PROPERTIES: LinkProperties = LinkProperties {
    name: "sim",
    connection_oriented: true,
    bytes_per_second: None,
    may_duplicate: false,
    frame_gap: Duration::from_millis(500),
};

/// A simulated device that a gateway can connect to.
#[derive(Debug, Clone)]
pub struct ServedDevice {
    /// Address for a gateway to connect to.
    pub address: Address,
    pub model: &'static str,
    /// Switch of the device. When the last copy is dropped, the device is switched off.
    pub switch: Switch,
}

/// A device to simulate: `sim://wsg50?part_mm=20`.
#[derive(Debug, Clone)]
pub struct SimulatedDevice(DeviceConfig);

impl SimulatedDevice {
    /// Parses a URL with a model and options.
    ///
    /// # Errors
    /// The fault in the URL, and the allowed values.
    pub fn from_url(url: &Url) -> Result<Self, String> {
        let model = url.host_str().unwrap_or_default();
        let mut device = Self::of_model(model).map_err(|error| format!("{url}: {error}"))?;
        for (option, value) in url.query_pairs() {
            device = device.with(&option, &value).map_err(|error| format!("{url}: {error}"))?;
        }
        Ok(device)
    }

    /// Returns a device of a model, without a part.
    ///
    /// # Errors
    /// The names of the models.
    pub fn of_model(model: &str) -> Result<Self, String> {
        let config = DeviceConfig::from_model(model);
        config.map(Self).ok_or_else(|| format!("unknown model {model:?}: use one of {MODELS}"))
    }

    #[must_use]
    pub const fn new(config: DeviceConfig) -> Self {
        Self(config)
    }

    /// Adds an option.
    ///
    /// # Errors
    /// The options and their allowed values.
    pub fn with(mut self, option: &str, value: &str) -> Result<Self, String> {
        self.0.set(option, value)?;
        Ok(self)
    }

    /// Switches the device on in this process, on the current runtime.
    pub(super) fn start(self, url: &str) -> InProcess {
        let (pipes, queue) = mpsc::channel(1);
        let switch = pump::start(Device::new(self.0, clock::instant()), Wire::InProcess(queue));
        InProcess { url: url.to_owned(), pipes, _switch: switch }
    }

    /// Changes the serial number, which distinguishes devices.
    fn numbered(mut self, index: usize) -> Self {
        self.0.serial_number = self.0.serial_number.wrapping_add(index as u32);
        self
    }
}

/// Connects to a simulated device in this process.
#[derive(Debug)]
pub(super) struct InProcess {
    url: String,
    pipes: mpsc::Sender<Pipe>,
    /// Keeps the device switched on.
    _switch: Switch,
}

impl Connector for InProcess {
    fn url(&self) -> String {
        self.url.clone()
    }

    fn properties(&self) -> LinkProperties {
        PROPERTIES
    }

    fn connect(&self) -> Pin<Box<dyn Future<Output = io::Result<Pipe>> + Send + '_>> {
        Box::pin(async {
            let (ours, theirs) = tokio::io::duplex(PIPE_BYTES);
            self.pipes.send(wire::pipe(theirs)).await.map_err(|_| io::ErrorKind::ConnectionRefused)?;
            Ok(wire::pipe(ours))
        })
    }
}
