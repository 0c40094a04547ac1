//! Checks of the grippers: whether each can be reached at its address.

use std::time::Duration;

use super::probe::{Identification, identify};
use super::running::{GatewayState, ServedGripper};
use super::{Diagnosis, Installation, Severity, can, clients, serial};
use crate::config::{DeviceSource, GripperConfig};
use crate::model::Name;
use crate::transport::{Address, SerialAddress, TcpAddress, UdpAddress};

/// Time for a reply.
const ANSWERS_WITHIN: Duration = Duration::from_millis(1500);

/// Time for a reply at another bit rate or over another transport, of which there are several.
const TRIED_FOR: Duration = Duration::from_millis(400);

/// Ports of devices (field practice).
const TCP_PORT: u16 = 1000;
const UDP_PORT: u16 = 1500;
const UDP_REPLY_PORT: u16 = 1501;

const CHECK: &str = "gripper";

/// Checks all grippers, one after another.
pub(super) async fn check(installation: &Installation, mut report: impl FnMut(&Diagnosis)) {
    for gripper in &installation.config.grippers {
        report(&check_one(&installation.running, gripper).await);
    }
}

async fn check_one(running: &GatewayState, gripper: &GripperConfig) -> Diagnosis {
    let (name, address) = match &gripper.device {
        DeviceSource::Simulated(_) => return Diagnosis::good(CHECK, format_args!("{} is simulated", gripper.name)),
        DeviceSource::At(address) => (&gripper.name, address),
    };
    match running {
        GatewayState::Answers { grippers } => {
            let served = of_running(name, address, grippers);
            let is_good = served.severity == Severity::Good;
            if is_good { served } else { check_interface(address).unwrap_or(served) }
        }
        GatewayState::Silent | GatewayState::Uncertain => check_interface(address).unwrap_or_else(|| {
            Diagnosis::good(CHECK, format_args!("{name} not contacted, because a running gateway may use it"))
        }),
        GatewayState::No | GatewayState::Other { .. } => match check_interface(address) {
            Some(finding) => finding,
            None => contact(name, address).await,
        },
    }
}

/// Returns a problem of the host's interface to the device.
fn check_interface(address: &Address) -> Option<Diagnosis> {
    match address {
        Address::Serial(address) => serial::check(address),
        Address::Can(address) => can::check(address),
        Address::Tcp(_) | Address::Udp(_) => None,
    }
}

/// Judges a gripper by the running gateway's list of grippers.
fn of_running(name: &Name, address: &Address, grippers: &[ServedGripper]) -> Diagnosis {
    let Some(ServedGripper { url, link, link_cause, .. }) = grippers.iter().find(|served| served.gripper == *name)
    else {
        return Diagnosis::warning(
            CHECK,
            format_args!("the running gateway does not have {name} yet: reload the gateway"),
        );
    };
    if *url != address.to_string() {
        let text = format!("the running gateway has {name} at {url}, not at {address}: reload the gateway");
        return Diagnosis::warning(CHECK, text);
    }
    let cause = link_cause.as_ref().map(|cause| format!(": {cause}")).unwrap_or_default();
    match link.as_str() {
        "connected" => Diagnosis::good(CHECK, format_args!("{name} is connected to the running gateway")),
        "released" => Diagnosis::warning(CHECK, format_args!("{name} was released{cause}")),
        _ => {
            let text = format!("{name}: {link}{cause}: see the guide on operation, Link causes");
            Diagnosis::problem(CHECK, text)
        }
    }
}

/// Connects to a device that no running gateway uses.
async fn contact(name: &Name, address: &Address) -> Diagnosis {
    if let Some(finding) = other_client(name, address).await {
        return finding;
    }
    let (text, hint) = match try_address(address, ANSWERS_WITHIN).await {
        Ok(Identification::Device(identity)) => {
            return Diagnosis::good(CHECK, format_args!("{name} at {address}: {identity}"));
        }
        Ok(Identification::Status(status)) => {
            return Diagnosis::good(CHECK, format_args!("{name} at {address} answers with the status {status}"));
        }
        Ok(Identification::Garbage) => (
            "bytes arrive, but no frames".to_owned(),
            "compare bit rate and stop bits with the gripper's settings, and check the cable's shield",
        ),
        Ok(Identification::Silence) => (
            "the device does not answer".to_owned(),
            "check power, cable and address, the command interface on the gripper's web page, and that no other \
             program or gateway uses the gripper",
        ),
        Ok(Identification::Closed(cause)) => {
            (cause, "check that no other program or gateway uses the gripper, because it accepts one client")
        }
        Err(error) => {
            (error.to_string(), "check power, cable and address, and the command interface on the gripper's web page")
        }
    };
    let remedy = instead(address).await.unwrap_or_else(|| hint.to_owned());
    Diagnosis::problem(CHECK, format_args!("{name} at {address}: {text}: {remedy}"))
}

async fn try_address(address: &Address, wait: Duration) -> std::io::Result<Identification> {
    let pipe = address.connect().await?;
    Ok(identify(pipe, address.properties().connection_oriented, wait).await)
}

/// Finds another program of this machine that is connected to the device.
async fn other_client(name: &Name, address: &Address) -> Option<Diagnosis> {
    let Address::Tcp(TcpAddress { host, port }) = address else { return None };
    let addresses: Vec<_> = tokio::net::lookup_host((host.as_str(), *port)).await.ok()?.collect();
    let client = clients::of(&addresses)?;
    let process = client.process.unwrap_or_else(|| "a program of another user".to_owned());
    let text = format!(
        "{name} at {address}: {process} on this machine is connected to it already: stop that program, or remove the \
         gripper from one of the two configurations, because a gripper accepts one client"
    );
    Some(Diagnosis::problem(CHECK, text))
}

/// Looks for the device at another bit rate or over the other network transport, and returns the remedy.
async fn instead(address: &Address) -> Option<String> {
    for other in alternatives(address) {
        if try_address(&other, TRIED_FOR).await.is_ok_and(|answer| answer.is_device()) {
            return Some(format!(
                "a gripper answers at {other} instead: write this URL, or change the gripper's settings"
            ));
        }
    }
    None
}

fn alternatives(address: &Address) -> Vec<Address> {
    match address {
        Address::Tcp(TcpAddress { host, port }) => distinct(vec![*port, UDP_PORT])
            .into_iter()
            .map(|port| Address::Udp(UdpAddress::new(host.clone(), port, UDP_REPLY_PORT)))
            .collect(),
        Address::Udp(UdpAddress { host, port, .. }) => distinct(vec![*port, TCP_PORT])
            .into_iter()
            .map(|port| Address::Tcp(TcpAddress { host: host.clone(), port }))
            .collect(),
        Address::Serial(address) => SerialAddress::BAUDS
            .into_iter()
            .filter(|baud| *baud != address.baud)
            .map(|baud| Address::Serial(SerialAddress { baud, ..address.clone() }))
            .collect(),
        Address::Can(_) => vec![],
    }
}

fn distinct(mut ports: Vec<u16>) -> Vec<u16> {
    ports.dedup();
    ports
}
