//! `wsg-gateway init`: a configuration with TLS and a first token, for a gateway on a network.

use std::collections::BTreeSet;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::net::{IpAddr, SocketAddr};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use jiff::Timestamp;

use super::token;
use crate::access::{Role, TokenFile};
use crate::config::DEFAULT_NAME;
use crate::connections::self_signed::SelfSigned;
use crate::model::Name;
use crate::transport::host::{InvalidHost, check_host};

/// Names of the files that `init` writes, in this order.
const CONFIG: &str = "wsg-gateway.toml";
const CERTIFICATE: &str = "certificate.pem";
const KEY: &str = "key.pem";
const TOKENS: &str = "tokens.json";

#[derive(Debug, Args)]
pub(super) struct InitArgs {
    /// Directory for the configuration, the certificate and the tokens
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// Address to serve HTTPS on
    #[arg(long, value_name = "ADDR", default_value = "0.0.0.0:8443")]
    listen: SocketAddr,
    #[command(flatten)]
    names: Names,
}

#[derive(Debug, Args)]
pub(super) struct CertificateArgs {
    /// Directory for certificate.pem and key.pem
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    #[command(flatten)]
    names: Names,
}

#[derive(Debug, Args)]
struct Names {
    /// A name or address that clients use for this host (repeatable) [default: the host's name, localhost and loopback]
    #[arg(long = "host", value_name = "NAME", value_parser = parse_host)]
    hosts: Vec<String>,
    /// Name of the gateway, for the certificate [default: gateway]
    #[arg(long = "name", value_name = "NAME")]
    gateway: Option<Name>,
}

pub(super) fn run(args: &InitArgs, mut output: impl Write) -> anyhow::Result<()> {
    let InitArgs { directory, listen, names } = args;
    fs::create_dir_all(directory).with_context(|| directory.display().to_string())?;
    if let Some(taken) =
        [CONFIG, CERTIFICATE, KEY, TOKENS].map(|name| directory.join(name)).iter().find(|path| path.exists())
    {
        bail!("{} exists: choose another directory, or remove it", taken.display());
    }
    let hosts = names.all(Some(listen.ip()));
    certify(directory, names, &hosts)?;
    let tokens = TokenFile::at(directory.join(TOKENS));
    let supervisor = token::new_token("supervisor".parse()?, Role::Supervisor, BTreeSet::new(), None);
    let secret = tokens.create(Timestamp::now(), supervisor)?;
    let config = directory.join(CONFIG);
    write(&config, 0o644, &configuration(*listen, names, &hosts))?;
    let shown = if listen.ip().is_unspecified() {
        hosts.first().cloned().unwrap_or_else(|| "localhost".to_owned())
    } else if listen.is_ipv6() {
        format!("[{}]", listen.ip())
    } else {
        listen.ip().to_string()
    };
    let text = format!(
        "wrote {config}\n\
         start: wsg-gateway --config {config}\n\
         open:  https://{shown}:{port}/ (the browser warns about the self-signed certificate)\n\
         sign in with the supervisor's token, which is shown only now:\n\
         {secret}",
        config = config.display(),
        port = listen.port(),
        secret = secret.expose()
    );
    Ok(writeln!(output, "{text}")?)
}

/// Writes a self-signed certificate.
pub(super) fn certificate(args: &CertificateArgs, mut output: impl Write) -> anyhow::Result<()> {
    fs::create_dir_all(&args.directory).with_context(|| args.directory.display().to_string())?;
    let hosts = args.names.all(None);
    certify(&args.directory, &args.names, &hosts)?;
    Ok(writeln!(output, "wrote {CERTIFICATE} and {KEY} for {}", hosts.join(", "))?)
}

fn parse_host(text: &str) -> Result<String, InvalidHost> {
    check_host(text).map(|()| text.to_owned())
}

impl Names {
    /// The names of the certificate.
    fn all(&self, listen: Option<IpAddr>) -> Vec<String> {
        if !self.hosts.is_empty() {
            return self.hosts.clone();
        }
        let system = rustix::system::uname();
        let host = system.nodename().to_str().ok().filter(|name| !name.is_empty() && *name != "localhost");
        let address = listen.filter(|address| !address.is_unspecified() && !address.is_loopback());
        let mut names: Vec<String> = host.map(str::to_ascii_lowercase).into_iter().collect();
        names.extend(address.map(|address| address.to_string()));
        names.extend(["localhost", "127.0.0.1", "::1"].map(str::to_owned));
        names
    }
}

fn certify(directory: &Path, names: &Names, hosts: &[String]) -> anyhow::Result<()> {
    let gateway = names.gateway.as_ref().map_or(DEFAULT_NAME, Name::as_str);
    let SelfSigned { certificate, key } = SelfSigned::create(gateway, hosts, Timestamp::now())?;
    write(&directory.join(KEY), 0o600, &key)?;
    write(&directory.join(CERTIFICATE), 0o644, &certificate)
}

/// Writes a new file. An existing one is kept.
fn write(path: &Path, mode: u32, text: &str) -> anyhow::Result<()> {
    let file = OpenOptions::new().write(true).create_new(true).mode(mode).open(path);
    let written = file.and_then(|mut file| file.write_all(text.as_bytes()));
    written.with_context(|| path.display().to_string())
}

fn configuration(listen: SocketAddr, names: &Names, hosts: &[String]) -> String {
    let name = names.gateway.as_ref().map(|name| format!("name = \"{name}\"\n")).unwrap_or_default();
    let hosts: Vec<_> = hosts.iter().filter(|host| host.parse::<IpAddr>().is_err() && *host != "localhost").collect();
    format!(
        "# A gateway on a network: clients need a token, and connections are encrypted.\n\
         # All keys are described in the guide \"Configuration\".\n\
         \n\
         {name}listen = \"{listen}\"\n\
         # Host names that browsers use for this gateway, besides its addresses.\n\
         hosts = {hosts:?}\n\
         \n\
         [tls]\n\
         certificate = \"{CERTIFICATE}\"\n\
         key = \"{KEY}\"\n\
         # The gateway renews this certificate before it ends, unless clients trust exactly this file: pinned = true\n\
         \n\
         [access]\n\
         # More tokens: wsg-gateway token create --config FILE --name plc7 --role operator --expires never\n\
         tokens = \"{TOKENS}\"\n\
         # Who may trigger a FAST STOP: \"credential\" for clients with any token, \"anyone\" for all.\n\
         fast_stop = \"credential\"\n\
         \n\
         # Replace this simulated gripper with yours, e.g. url = \"tcp://192.168.1.20:1000\".\n\
         [grippers.left]\n\
         url = \"sim://wsg50?part_mm=20&finger1=fmf\"\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, Flags};

    fn args(directory: &Path) -> InitArgs {
        let names = Names { hosts: vec!["cell-7.example".to_owned()], gateway: Some("cell-7".parse().unwrap()) };
        InitArgs { directory: directory.to_owned(), listen: "0.0.0.0:8443".parse().unwrap(), names }
    }

    #[test]
    fn written_configuration_is_valid_and_kept() {
        let directory = std::env::temp_dir().join(format!("wsg-init-{}", std::process::id()));
        let mut output = Vec::new();
        run(&args(&directory), &mut output).unwrap();
        let said = String::from_utf8(output).unwrap();
        assert!(said.contains("https://cell-7.example:8443/") && said.contains("wsg_"), "{said}");
        let flags = Flags { config: Some(directory.join(CONFIG)), ..Flags::default() };
        let config = Config::load(&flags).unwrap();
        assert_eq!((config.web.hosts, config.listen.port()), (vec!["cell-7.example".to_owned()], 8443));
        assert_eq!(config.name.as_str(), "cell-7");
        let again = run(&args(&directory), &mut Vec::new()).unwrap_err().to_string();
        assert!(again.contains("exists"), "{again}");
        fs::remove_dir_all(directory).unwrap();
    }
}
