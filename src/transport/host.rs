//! Hosts in settings: check of the written text, resolution of names, and connections to one address after another.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::Duration;

use tokio::net::TcpStream;
use tokio::time::{Instant, timeout};
use url::{Host, ParseError, Url};

/// Reason why a URL of a web server is not valid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidWebUrl {
    #[error("is not a valid URL ({0})")]
    Syntax(ParseError),
    #[error("has the host {0}")]
    Host(InvalidHost),
}

/// A host that looks like an IPv4 address, and is not one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?}, which is not a plain IPv4 address: write four decimal numbers from 0 to 255 without leading zeros, such as \
     192.168.1.20"
)]
pub struct InvalidHost(String);

/// Checks a host name or an IPv4 address. The system's resolver reads `192.168.001.020` as 192.168.1.16 and `127.1` as
/// 127.0.0.1, so what ends in a number must be a plain address. IPv6 addresses have one reading only.
///
/// # Errors
/// [`InvalidHost`].
pub fn check_host(host: &str) -> Result<(), InvalidHost> {
    let last_label = host.trim_end_matches('.').rsplit('.').next().unwrap_or_default();
    let is_ipv6 = host.contains(':');
    if !is_ipv6 && is_number(last_label) && host.parse::<Ipv4Addr>().is_err() {
        return Err(InvalidHost(host.to_owned()));
    }
    Ok(())
}

/// Checks the address of a network. The parser of networks takes leading zeros, which others read as octal.
///
/// # Errors
/// [`InvalidHost`].
pub fn check_network(text: &str) -> Result<(), InvalidHost> {
    check_host(text.split('/').next().unwrap_or_default())
}

/// Whether a label of a host is a decimal or a hexadecimal number (WHATWG URL, "ends in a number").
fn is_number(label: &str) -> bool {
    let hexadecimal = label.strip_prefix("0x").or_else(|| label.strip_prefix("0X"));
    match hexadecimal {
        Some(digits) => digits.bytes().all(|byte| byte.is_ascii_hexdigit()),
        None => !label.is_empty() && label.bytes().all(|byte| byte.is_ascii_digit()),
    }
}

/// Parses an `http`, `https` or `ws` URL. For these, the parser itself turns `127.1` into 127.0.0.1, so an address is
/// compared with the text.
///
/// # Errors
/// [`InvalidWebUrl`].
pub fn parse_web_url(text: &str) -> Result<Url, InvalidWebUrl> {
    let url = Url::parse(text).map_err(|error| match error {
        ParseError::InvalidIpv4Address => invalid_host(text),
        error => InvalidWebUrl::Syntax(error),
    })?;
    match url.host() {
        Some(Host::Ipv4(address)) if written_host(text) != address.to_string() => Err(invalid_host(text)),
        _ => Ok(url),
    }
}

fn invalid_host(text: &str) -> InvalidWebUrl {
    InvalidWebUrl::Host(InvalidHost(written_host(text).to_owned()))
}

/// Host in the text of a URL, as written, up to the port. The host is not an IPv6 address.
fn written_host(text: &str) -> &str {
    let after_scheme = text.split_once(':').map_or(text, |(_, rest)| rest);
    let authority = after_scheme.trim_start_matches(['/', '\\']).split(['/', '\\', '?', '#']).next();
    let authority = authority.unwrap_or_default();
    let host = authority.rsplit_once('@').map_or(authority, |(_, host)| host);
    host.split(':').next().unwrap_or_default()
}

/// Kind of an address that no single device can have, or `None`.
pub(super) fn kind_of_no_device(address: IpAddr) -> Option<&'static str> {
    match address.to_canonical() {
        address if address.is_unspecified() => Some("the unspecified address"),
        address if address.is_multicast() => Some("a multicast address"),
        IpAddr::V4(Ipv4Addr::BROADCAST) => Some("the broadcast address"),
        _ => None,
    }
}

/// Returns the addresses of a host: a name, an IPv4 address, or an IPv6 address with or without a zone.
///
/// # Errors
/// The system's error with the host, or a timeout.
pub async fn resolve(host: &str, port: u16, within: Duration) -> io::Result<Vec<SocketAddr>> {
    let lookup = timeout(within, tokio::net::lookup_host((host, port))).await;
    let found = lookup.map_err(|_| {
        let detail = format!("host name {host:?} was not resolved within {} s", seconds(within));
        io::Error::new(io::ErrorKind::TimedOut, detail)
    })?;
    let found = found.map_err(|error| {
        let remedy = match host.split_once('%') {
            Some((_, zone)) => format!("check that the network interface {zone:?} exists"),
            None => "check the name, or use the IP address".to_owned(),
        };
        io::Error::new(error.kind(), format!("host {host:?}: {error}: {remedy}"))
    })?;
    let mut addresses: Vec<SocketAddr> = Vec::new();
    for address in found {
        if !addresses.contains(&address) {
            addresses.push(address);
        }
    }
    if addresses.is_empty() {
        return Err(io::Error::new(io::ErrorKind::NotFound, format!("host name {host:?} has no address")));
    }
    Ok(addresses)
}

/// Connects to the first address that accepts. Each address gets its share of the time that is left, so that one that
/// does not answer leaves time for the others.
///
/// # Errors
/// The error of each address.
pub async fn connect_to_first(addresses: &[SocketAddr], within: Duration) -> io::Result<TcpStream> {
    let deadline = Instant::now() + within;
    let mut failures = Vec::new();
    for (index, address) in addresses.iter().enumerate() {
        let left = deadline.saturating_duration_since(Instant::now());
        let untried = (addresses.len() - index) as u32;
        let share = left / untried;
        let failure = match timeout(share, TcpStream::connect(address)).await {
            Ok(Ok(stream)) => return Ok(stream),
            Ok(Err(error)) => error,
            Err(_) => io::Error::new(io::ErrorKind::TimedOut, format!("no connection within {} s", seconds(share))),
        };
        failures.push((address, failure));
    }
    match failures.pop() {
        None => Err(io::Error::new(io::ErrorKind::NotFound, "the host has no address")),
        Some((_, only)) if failures.is_empty() => Err(only),
        Some(last) => {
            let kind = last.1.kind();
            failures.push(last);
            let texts: Vec<_> = failures.iter().map(|(address, error)| format!("{}: {error}", address.ip())).collect();
            Err(io::Error::new(kind, texts.join("; ")))
        }
    }
}

/// Resolves a host, and connects to the first of its addresses that accepts.
///
/// # Errors
/// Those of [`resolve`] and [`connect_to_first`].
pub async fn connect_to_host(host: &str, port: u16, within: Duration) -> io::Result<TcpStream> {
    let deadline = Instant::now() + within;
    let addresses = resolve(host, port, within).await?;
    connect_to_first(&addresses, deadline.saturating_duration_since(Instant::now())).await
}

/// Seconds, rounded to tenths, for an error.
fn seconds(time: Duration) -> f64 {
    (time.as_secs_f64() * 10.0).round() / 10.0
}

#[cfg(test)]
#[path = "host_tests.rs"]
mod tests;
