//! The `wsg-gateway sim` command.

use std::io::Write;
use std::net::SocketAddr;

use anyhow::{Context as _, anyhow};
use url::Url;

use super::wire::Wire;
use super::{ServedDevice, SimulatedDevice, control, pump};
use crate::model::clock;
use crate::sim::Device;

/// Serves a simulated device, on the current runtime: on `tcp://127.0.0.1:1000`,
/// `udp://127.0.0.1:1500?reply_port=1501`, `serial://pty?baud=115200&link=/tmp/gripper`, or
/// `can://vcan0?rx=0x64&tx=0x65`, where rx is what the device listens to. The other options are the device's, as in a
/// `sim://` URL.
///
/// # Errors
/// The reason why the URL cannot be served, and the allowed values.
pub async fn serve(url: &Url, device: SimulatedDevice) -> anyhow::Result<ServedDevice> {
    let (url, device) = take_device_options(url, device)?;
    let wire = Wire::new(&url).await?;
    let address = wire.address()?.with_context(|| format!("{url} has no address"))?;
    let model = device.0.model.name();
    let switch = pump::start(Device::new(device.0, clock::instant()), wire);
    Ok(ServedDevice { address, model, switch })
}

/// Applies the options of the device, and returns the URL with those of the transport alone.
fn take_device_options(url: &Url, mut device: SimulatedDevice) -> anyhow::Result<(Url, SimulatedDevice)> {
    let mut of_wire = url.clone();
    of_wire.set_query(None);
    let transport = Wire::options(url.scheme());
    for (name, value) in url.query_pairs() {
        if transport.contains(&&*name) {
            of_wire.query_pairs_mut().append_pair(&name, &value);
            continue;
        }
        device = device.with(&name, &value).map_err(|error| match transport {
            [] => anyhow!("{url}: {error}"),
            _ => anyhow!("{url}: {error}; options of {}: {}", url.scheme(), transport.join(", ")),
        })?;
    }
    Ok((of_wire, device))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn options_of_the_device_are_taken_from_any_url() {
        let link = std::env::temp_dir().join(format!("wsg-options-{}", std::process::id()));
        let serial = format!("serial://pty?baud=9600&link={}&part_mm=20", link.display());
        for url in ["tcp://127.0.0.1:0?part_mm=20", "udp://127.0.0.1:0?part_mm=20&reply_port=1777", &serial] {
            let device = SimulatedDevice::of_model("wsg50").unwrap();
            let served = serve(&url.parse().unwrap(), device).await.unwrap();
            let part = served.switch.snapshot().await.unwrap().part.map(|part| part.width_mm);
            assert_eq!(part, Some(20.0), "{url}");
            let address = served.address.to_string();
            let own = [("udp", "local_port=1777"), ("serial", "baud=9600")];
            assert!(
                own.iter().all(|(scheme, option)| !url.starts_with(scheme) || address.contains(option)),
                "{address}"
            );
        }
    }
}
