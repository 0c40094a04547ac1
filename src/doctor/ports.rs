//! Check of the addresses that the gateway listens on.

use std::net::{SocketAddr, TcpListener, UdpSocket};

use super::running::GatewayState;
use super::{Diagnosis, Installation};
use crate::connections::sockets::remedy;
use crate::interfaces::wsg_port::ListenAddress;

pub(super) fn check(installation: &Installation) -> Vec<Diagnosis> {
    match installation.running {
        GatewayState::Silent | GatewayState::Answers { .. } => {
            return vec![Diagnosis::good("ports", "in use by this gateway, which is running")];
        }
        GatewayState::Uncertain => {
            return vec![Diagnosis::good("ports", "not checked, because this gateway may be running")];
        }
        GatewayState::No | GatewayState::Other { .. } => {}
    }
    let config = &installation.config;
    let mut findings = vec![tcp("--listen", config.listen)];
    findings.extend(config.modbus.iter().map(|modbus| tcp("Modbus", modbus.address)));
    for gripper in &config.grippers {
        let what = format!("WSG port of {}", gripper.name);
        findings.extend(gripper.wsg_port.addresses.iter().map(|(address, _)| match *address {
            ListenAddress::Tcp(address) => tcp(&what, address),
            ListenAddress::Udp(address, _) => finding(&what, address, UdpSocket::bind(address).map(drop)),
        }));
    }
    // Zenoh resolves endpoints with names.
    let endpoints = config.zenoh.iter().flat_map(|zenoh| &zenoh.listen);
    let addresses = endpoints.filter_map(|endpoint| endpoint.split_once('/')?.1.parse().ok());
    findings.extend(addresses.map(|address| tcp("Zenoh", address)));
    findings
}

fn tcp(what: &str, address: SocketAddr) -> Diagnosis {
    finding(what, address, TcpListener::bind(address).map(drop))
}

fn finding(what: &str, address: SocketAddr, bound: std::io::Result<()>) -> Diagnosis {
    match bound {
        Ok(()) => Diagnosis::good("ports", format_args!("{address} is free ({what})")),
        Err(error) => {
            let remedy = remedy(error.kind());
            Diagnosis::problem("ports", format_args!("cannot listen on {address} ({what}): {error}: {remedy}"))
        }
    }
}
