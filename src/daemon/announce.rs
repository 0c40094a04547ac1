//! The announcement on standard output: the addresses, and a command to try.

use std::io::Write;
use std::net::SocketAddr;

use super::ports::BoundPort;
use crate::config::Config;
use crate::gripper::model::Name;

/// Prints what is served, where, and what to try. Ignores write errors, since nobody may be reading.
pub(super) fn announce(
    config: &Config,
    address: SocketAddr,
    ports: &[BoundPort],
    modbus: Option<SocketAddr>,
) -> std::io::Result<()> {
    let urls =
        ports.iter().map(|port| Ok((port.gripper(), port.listener.url()?))).collect::<std::io::Result<Vec<_>>>()?;
    let mut out = std::io::stdout().lock();
    let _ = write_announcement(config, (address, modbus), &urls, &mut out).and_then(|()| out.flush());
    Ok(())
}

/// Prints the addresses of Zenoh, which can be known later than the rest.
pub(super) fn announce_zenoh(locators: &[String]) {
    let mut out = std::io::stdout().lock();
    for locator in locators {
        let _ = writeln!(out, "Zenoh: {locator}").and_then(|()| out.flush());
    }
}

fn write_announcement(
    config: &Config,
    (address, modbus): (SocketAddr, Option<SocketAddr>),
    ports: &[(&Name, String)],
    out: &mut impl Write,
) -> std::io::Result<()> {
    let base = format!("{}://{address}", config.scheme());
    writeln!(out, "wsg-gateway {} serves {} at {base}/", env!("CARGO_PKG_VERSION"), config.name)?;
    for gripper in &config.grippers {
        writeln!(out, "  {:<8} {}", gripper.name.as_str(), gripper.device)?;
    }
    for (name, url) in ports {
        writeln!(out, "WSG port of {name}: {url}")?;
    }
    if let Some(address) = modbus {
        writeln!(out, "Modbus: {address}")?;
    }
    writeln!(out, "documentation: {base}/docs")?;
    writeln!(out, "guides: {base}/docs/guide")?;
    if let Some(gripper) = config.grippers.first() {
        writeln!(out, "try: curl -X POST {base}/api/v1/grippers/{}/home", gripper.name)?;
    }
    Ok(())
}
