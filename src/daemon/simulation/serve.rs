//! The `wsg-gateway sim` command.

use std::io::Write;
use std::net::SocketAddr;

use anyhow::Context as _;
use url::Url;

use super::wire::Wire;
use super::{SimulatedDevice, Switch, control, pump};
use crate::gripper::clock;
use crate::sim::Device;
use crate::transport::Address;

#[derive(Debug, Clone)]
pub struct ServedDevice {
    /// Address for a gateway to connect to.
    pub address: Address,
    pub model: &'static str,
    /// Switch of the device. When the last copy is dropped, the device is switched off.
    pub switch: Switch,
}

/// Serves a simulated device, on the current runtime: on `tcp://127.0.0.1:1000`,
/// `udp://127.0.0.1:1500?reply_port=1501`, `serial://pty?baud=115200&link=/tmp/gripper`, or
/// `can://vcan0?rx=0x64&tx=0x65`, where rx is what the device listens to.
///
/// # Errors
/// The reason why the URL cannot be served, and the allowed values.
pub async fn serve(url: &Url, device: SimulatedDevice) -> anyhow::Result<ServedDevice> {
    let wire = Wire::new(url).await?;
    let address = wire.address()?.with_context(|| format!("{url} has no address"))?;
    let model = device.0.model.name();
    let switch = pump::start(Device::new(device.0, clock::instant()), wire);
    Ok(ServedDevice { address, model, switch })
}

/// Serves a simulated device on each URL, and the control port for their faults, until it is cancelled. Prints the
/// addresses.
///
/// # Errors
/// The URL that cannot be served, and the reason.
pub async fn serve_simulated(
    urls: &[Url],
    device: &SimulatedDevice,
    control: Option<SocketAddr>,
) -> anyhow::Result<()> {
    let mut devices = Vec::new();
    for (index, url) in urls.iter().enumerate() {
        let served = serve(url, device.clone().numbered(index)).await?;
        say(&format!("a simulated {} at {}", served.model, served.address));
        devices.push(served);
    }
    match control {
        Some(address) => {
            let listener = control::listen(address).await?;
            say(&format!("fault injection at http://{}/devices", listener.local_addr()?));
            control::serve(listener, devices).await
        }
        None => std::future::pending().await,
    }
}

/// Prints a line. Ignores errors, since nobody may be reading.
fn say(line: &str) {
    let _ = writeln!(std::io::stdout(), "{line}");
}
