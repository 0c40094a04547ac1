//! `wsg-gateway reload`: makes a running gateway read its configuration again, and prints the changes.

use std::fs;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, bail};
use bytes::Bytes;
use clap::Args;
use http::Request;
use http::header::{AUTHORIZATION, CONTENT_TYPE, HOST};
use http_body_util::{BodyExt as _, Full};
use hyper::client::conn::http1;
use hyper_util::rt::TokioIo;
use serde::Deserialize;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};
use url::Url;

use crate::config::{Config, Flags};
use crate::connections::tls::server_name;
use crate::model::without_byte_order_mark;
use crate::transport::host::{connect_to_host, parse_web_url};

/// Time limit for connecting to any of the gateway's addresses.
const CONNECTED_WITHIN: Duration = Duration::from_secs(10);

#[derive(Debug, Args)]
pub(super) struct ReloadArgs {
    /// Address of the gateway [default: the one in the configuration file, or http://127.0.0.1:8080/]
    #[arg(long, value_name = "URL", value_parser = parse_web_url)]
    url: Option<Url>,
    /// Configuration file of the gateway: tells where it listens, and which certificate to trust
    #[arg(long, value_name = "FILE", env = "WSG_GATEWAY_CONFIG")]
    config: Option<PathBuf>,
    /// Certificate to trust instead, in PEM
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// File with a supervisor's token [default: the environment variable WSG_GATEWAY_TOKEN]
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

/// The answer to a reload: the changes, or a problem.
#[derive(Deserialize)]
struct Answer {
    changes: Option<Vec<String>>,
    code: Option<String>,
    detail: Option<String>,
}

/// Describes the changes, one per line.
pub(super) fn described(changes: &[String]) -> String {
    if changes.is_empty() { "no changes".to_owned() } else { changes.join("\n") }
}

/// Reads the token in a file.
fn token_in(path: &Path) -> anyhow::Result<String> {
    let text = fs::read(path).with_context(|| path.display().to_string())?;
    let token = std::str::from_utf8(without_byte_order_mark(&text)).with_context(|| path.display().to_string())?;
    Ok(token.to_owned())
}

/// Reloads, and returns the changes.
///
/// # Errors
/// The reason why nothing has changed, and the remedy.
pub(super) async fn reload(args: &ReloadArgs) -> anyhow::Result<Vec<String>> {
    let config =
        args.config.as_ref().map(|path| Config::load(&Flags { config: Some(path.clone()), ..Flags::default() }));
    let config = config.transpose()?;
    let url = args.url.clone().map_or_else(|| url_of(config.as_ref()), Ok)?;
    let token = match &args.token_file {
        Some(path) => Some(token_in(path)?),
        None => std::env::var("WSG_GATEWAY_TOKEN").ok(),
    };
    let host = url.host_str().context("the URL has no host: write http://127.0.0.1:8080/")?;
    let port = url.port_or_known_default().unwrap_or(80);
    let address = host.trim_start_matches('[').trim_end_matches(']');
    let stream = connect_to_host(address, port, CONNECTED_WITHIN).await;
    let stream = stream.with_context(|| format!("cannot connect to {url}: check that the gateway runs there"))?;
    let mut request = Request::post("/api/v1/reload").header(HOST, format!("{host}:{port}"));
    request = request.header(CONTENT_TYPE, "application/json");
    if let Some(token) = &token {
        request = request.header(AUTHORIZATION, format!("Bearer {}", token.trim()));
    }
    let request = request.body(Full::new(Bytes::from_static(b"{}")))?;
    let body = if url.scheme() == "https" {
        let own = config.and_then(|config| config.tls).map(|tls| tls.certificate);
        let trusted =
            args.ca.clone().or(own).context("name the certificate to trust with --ca, or the --config file")?;
        let (config, name) = trusting(&trusted, address)?;
        let stream = TlsConnector::from(Arc::new(config)).connect(name, stream).await;
        exchange(stream.with_context(|| format!("no TLS connection to {url}"))?, request).await?
    } else {
        exchange(stream, request).await?
    };
    let answer: Answer = serde_json::from_slice(&body).with_context(|| format!("{url} is not a gateway"))?;
    match answer {
        Answer { changes: Some(changes), .. } => Ok(changes),
        Answer { code: Some(code), .. } if token.is_none() && code == "unauthorized" => {
            bail!("the gateway at {url} needs a supervisor's token: pass --token-file FILE, or set WSG_GATEWAY_TOKEN")
        }
        Answer { detail, .. } => bail!(detail.unwrap_or_else(|| format!("{url} is not a gateway"))),
    }
}

/// Returns where a gateway with this configuration listens, as seen from its own host.
fn url_of(config: Option<&Config>) -> anyhow::Result<Url> {
    let Some(config) = config else { return Ok("http://127.0.0.1:8080/".parse()?) };
    let mut listen = config.listen;
    if listen.ip().is_unspecified() {
        let loopback: IpAddr = if listen.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() };
        listen.set_ip(loopback);
    }
    Ok(format!("{}://{listen}/", config.scheme()).parse()?)
}

/// Trusts the certificates in a file. The server's certificate must be valid for the first DNS name in the first of
/// them, or for `host` if that one has no DNS name.
fn trusting(path: &Path, host: &str) -> anyhow::Result<(ClientConfig, ServerName<'static>)> {
    let pem = fs::read(path).with_context(|| path.display().to_string())?;
    let pem = without_byte_order_mark(&pem);
    let certificates = CertificateDer::pem_slice_iter(pem).collect::<Result<Vec<_>, _>>();
    let certificates = certificates.with_context(|| no_certificate(path))?;
    let mut roots = RootCertStore::empty();
    for certificate in &certificates {
        roots.add(certificate.clone()).with_context(|| no_certificate(path))?;
    }
    let name = certificates.first().and_then(server_name).unwrap_or_else(|| host.to_owned());
    let config = ClientConfig::builder_with_provider(Arc::new(default_provider()))
        .with_safe_default_protocol_versions()?
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok((config, ServerName::try_from(name)?))
}

fn no_certificate(path: &Path) -> String {
    format!("{} has no certificate in PEM", path.display())
}

async fn exchange<T: AsyncRead + AsyncWrite + Send + Unpin + 'static>(
    stream: T,
    request: Request<Full<Bytes>>,
) -> anyhow::Result<Bytes> {
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await?;
    let connection = tokio::spawn(connection);
    let response = sender.send_request(request).await?;
    let body = response.into_body().collect().await?.to_bytes();
    connection.abort();
    Ok(body)
}
