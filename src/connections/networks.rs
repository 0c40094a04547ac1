//! Networks of clients in the configuration.

use std::net::IpAddr;

use ipnet::IpNet;

use crate::settings::{SettingError, SettingValue, deserialize};
use crate::transport::host::check_network;

/// A list of allowed networks.
#[must_use]
pub fn networks(default: &str, example: &str) -> SettingValue<Vec<IpNet>> {
    SettingValue::new(Vec::new(), "", "IP addresses and networks", |key, value| {
        let offset = value.span().start;
        let texts: Vec<String> = deserialize(value)?;
        if texts.is_empty() {
            let detail = format!("{key} is empty: list the allowed networks, or remove it if the port is on loopback");
            return Err(SettingError { offset, detail });
        }
        texts.iter().map(|text| parse_network(text).map_err(|detail| SettingError { offset, detail })).collect()
    })
    .shown(default, example)
}

/// Parses an address or a network, and returns it in canonical form, as clients' addresses are.
pub fn parse_network(text: &str) -> Result<IpNet, String> {
    let network: IpNet = text
        .parse()
        .or_else(|_| text.parse::<IpAddr>().map(IpNet::from))
        .map_err(|_| format!("{text:?} is neither an address nor a network: write 192.168.1.10 or 192.168.1.0/24"))?;
    check_network(text).map_err(|error| format!("a network has the address {error}"))?;
    // An address with the prefix of a network looks like one address, but would admit the whole network.
    if network.addr() != network.network() {
        let address = network.addr();
        let network = network.trunc();
        return Err(format!("{text:?} is an address with the prefix of a network: write {address} or {network}"));
    }
    Ok(match network.addr().to_canonical() {
        IpAddr::V4(address) if network.prefix_len() >= 96 => {
            IpNet::new(address.into(), network.prefix_len() - 96).unwrap_or(network)
        }
        _ => network,
    })
}
