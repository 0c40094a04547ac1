//! The device's end of each transport.

use std::io;
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use url::{Host, Url};

use super::super::listen::failed;
use super::{pty, udp};
use crate::sim::Interface;
use crate::transport::host::check_host;
use crate::transport::{Address, CanAddress, Pipe, TcpAddress};

/// The port that devices listen on (field practice).
const DEFAULT_TCP_PORT: u16 = 1000;

/// Pause after a failed accept, or a wire that could not be made.
const REST: Duration = Duration::from_millis(500);

/// Source and destination of a device's bytes.
pub(super) enum Wire {
    /// Pipes in this process, for `sim://`, which stand for connections.
    InProcess(mpsc::Receiver<Pipe>),
    Tcp(TcpListener),
    Udp(udp::Endpoint),
    Pty(pty::PtySource),
    Can(CanAddress),
}

impl Wire {
    /// Options of a transport in a URL of `wsg-gateway sim`.
    pub(super) fn options(scheme: &str) -> &'static [&'static str] {
        match scheme {
            "udp" => &udp::OPTIONS,
            "serial" => &pty::OPTIONS,
            "can" => &CanAddress::OPTIONS,
            _ => &[],
        }
    }

    /// Creates the wire for a URL of `wsg-gateway sim`.
    pub(super) async fn new(url: &Url) -> anyhow::Result<Self> {
        if let ("tcp" | "udp", Some(Host::Domain(name))) = (url.scheme(), url.host()) {
            check_host(name).with_context(|| format!("{url} cannot be served"))?;
        }
        let wire = match url.scheme() {
            "tcp" => listen(url).await,
            "udp" => udp::Endpoint::new(url).await.map(Self::Udp),
            "serial" => pty::PtySource::new(url).map(Self::Pty),
            "can" => match url.as_str().parse()? {
                // A missing interface is reported better here than in the log.
                Address::Can(address) => {
                    Address::Can(address.clone()).connect().await.map(|_| Self::Can(address)).map_err(Into::into)
                }
                other => Err(anyhow!("{other} is not a CAN address")),
            },
            scheme => Err(anyhow!("unknown transport {scheme:?}: use tcp, udp, serial or can")),
        };
        wire.with_context(|| format!("{url} cannot be served"))
    }

    pub(super) const fn interface(&self) -> Interface {
        match self {
            Self::InProcess(_) | Self::Tcp(_) => Interface::Tcp,
            Self::Udp(_) => Interface::Udp,
            Self::Pty(_) => Interface::Serial,
            Self::Can(_) => Interface::Can,
        }
    }

    /// Address for a gateway to connect to; `None` within the same process.
    pub(super) fn address(&self) -> io::Result<Option<Address>> {
        Ok(match self {
            Self::InProcess(_) => None,
            Self::Tcp(listener) => {
                let address = listener.local_addr()?;
                Some(Address::Tcp(TcpAddress { host: address.ip().to_string(), port: address.port() }))
            }
            Self::Udp(endpoint) => Some(Address::Udp(endpoint.address()?)),
            Self::Pty(socket) => Some(Address::Serial(socket.address())),
            Self::Can(CanAddress { interface, tx, rx, bitrate }) => {
                // A gateway sends with the id that the device receives.
                let interface = interface.clone();
                let bitrate = *bitrate;
                Some(Address::Can(CanAddress { interface, tx: *rx, rx: *tx, bitrate }))
            }
        })
    }

    /// The next connection or its equivalent; `None` if no more can come. Cancellation loses nothing.
    pub(super) async fn next(&mut self) -> Option<Pipe> {
        loop {
            let next = match self {
                Self::InProcess(pipes) => return pipes.recv().await,
                Self::Tcp(listener) => accept(listener).await,
                Self::Udp(endpoint) => Ok(endpoint.open()),
                Self::Pty(socket) => socket.open(),
                Self::Can(address) => Address::Can(address.clone()).connect().await,
            };
            match next {
                Ok(pipe) => return Some(pipe),
                Err(error) => {
                    tracing::warn!(%error, "wire of the simulated device failed: retrying");
                    tokio::time::sleep(REST).await;
                }
            }
        }
    }
}

async fn listen(url: &Url) -> anyhow::Result<Wire> {
    let addresses = url.socket_addrs(|| Some(DEFAULT_TCP_PORT))?;
    let listener = TcpListener::bind(addresses.as_slice()).await;
    Ok(Wire::Tcp(listener.map_err(|error| failed("cannot listen", error))?))
}

async fn accept(listener: &TcpListener) -> io::Result<Pipe> {
    let (stream, peer) = listener.accept().await?;
    tracing::info!(%peer, "client connected");
    // Frames are small, and each is written separately.
    let _ = stream.set_nodelay(true);
    Ok(pipe(stream))
}

/// Turns a stream into a pipe.
pub(super) fn pipe(stream: impl tokio::io::AsyncRead + tokio::io::AsyncWrite + Send + 'static) -> Pipe {
    let (reader, writer) = tokio::io::split(stream);
    Pipe::new(reader, writer)
}
