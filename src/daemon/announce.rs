//! The announcement on standard output: the addresses, and a command to try.

use std::io::Write;
use std::net::SocketAddr;

use super::ports::BoundPort;
use crate::config::{AccessConfig, Config};
use crate::model::Name;

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
        writeln!(out, "try: curl {}-X POST {base}/api/v1/grippers/{}/home", curl_options(config), gripper.name)?;
    }
    Ok(())
}

/// Returns the options with which curl trusts the gateway's certificate and sends a token, as far as they are needed.
fn curl_options(config: &Config) -> String {
    let mut options = String::new();
    if let Some(tls) = &config.tls {
        let path = tls.certificate.display().to_string();
        let quote = if path.contains(' ') { "'" } else { "" };
        options = format!("--cacert {quote}{path}{quote} ");
    }
    if config.access != AccessConfig::Open {
        options += "-H \"Authorization: Bearer TOKEN\" ";
    }
    options
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Flags;
    use crate::connections::tls::TlsFiles;

    #[test]
    fn command_to_try_has_certificate_and_token_only_if_needed() {
        let open = Config::load(&Flags::default()).unwrap();
        let guarded = Config::load(&Flags { tokens: Some("tokens.json".into()), ..Flags::default() }).unwrap();
        let tls =
            TlsFiles { certificate: "my files/a.pem".into(), key: "b.pem".into(), client_ca: None, pinned: false };
        let encrypted = Config { tls: Some(tls), ..guarded.clone() };
        let token = "-H \"Authorization: Bearer TOKEN\" ";
        assert_eq!(curl_options(&open), "");
        assert_eq!(curl_options(&guarded), token);
        assert_eq!(curl_options(&encrypted), format!("--cacert 'my files/a.pem' {token}"));
        let mut out = Vec::new();
        write_announcement(&encrypted, ("127.0.0.1:8443".parse().unwrap(), None), &[], &mut out).unwrap();
        let said = String::from_utf8(out).unwrap();
        let expected = format!("{token}-X POST https://127.0.0.1:8443/api/v1/grippers/left/home\n");
        assert!(said.ends_with(&expected), "{said}");
    }
}
