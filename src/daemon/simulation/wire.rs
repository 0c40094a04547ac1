//! The device's end of each transport.

use std::io;
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use url::Url;

use super::{pty, udp};
use crate::sim::Interface;
use crate::transport::{Address, CanAddress, Pipe, TcpAddress};

/// The port that devices listen on (field practice).
const DEFAULT_TCP_PORT: u16 = 1000;

/// How long a listener rests that could not accept, and a wire that could not be made.
const REST: Duration = Duration::from_millis(500);

/// Where the bytes of a device come from and go to.
pub(super) enum Wire {
    /// Pipes in this process, for `sim://`, which stand for connections.
    InProcess(mpsc::Receiver<Pipe>),
    Tcp(TcpListener),
    Udp(udp::Endpoint),
    Pty(pty::Socket),
    Can(CanAddress),
}

impl Wire {
    /// What a URL of `wsg-gateway sim` asks for.
    pub(super) async fn new(url: &Url) -> anyhow::Result<Self> {
        let wire = match url.scheme() {
            "tcp" => listen(url).await,
            "udp" => udp::Endpoint::new(url).await.map(Self::Udp),
            "serial" => pty::Socket::new(url).map(Self::Pty),
            "can" => match url.as_str().parse()? {
                // Whether there is such an interface is better said now than in the log.
                Address::Can(address) => {
                    Address::Can(address.clone()).connect().await.map(|_| Self::Can(address)).map_err(Into::into)
                }
                other => Err(anyhow!("{other} is not on CAN")),
            },
            scheme => Err(anyhow!("there is no transport {scheme:?}; there are tcp, udp, serial, can")),
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

    /// Where a gateway finds it; of no use to one in the same process.
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
                // Whoever talks to it sends what it receives.
                let (interface, bitrate) = (interface.clone(), *bitrate);
                Some(Address::Can(CanAddress { interface, tx: *rx, rx: *tx, bitrate }))
            }
        })
    }

    /// The next connection, or what stands for one. `None` when there can't be any more. Cancelled without loss.
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
                    tracing::warn!(%error, "the device has no wire");
                    tokio::time::sleep(REST).await;
                }
            }
        }
    }
}

async fn listen(url: &Url) -> anyhow::Result<Wire> {
    let addresses = url.socket_addrs(|| Some(DEFAULT_TCP_PORT))?;
    Ok(Wire::Tcp(TcpListener::bind(addresses.as_slice()).await.context("cannot listen")?))
}

async fn accept(listener: &TcpListener) -> io::Result<Pipe> {
    let (stream, peer) = listener.accept().await?;
    tracing::info!(%peer, "a client connects");
    // Frames are small, and each is a write of its own.
    let _ = stream.set_nodelay(true);
    Ok(pipe(stream))
}

/// A stream as a pipe.
pub(super) fn pipe(stream: impl tokio::io::AsyncRead + tokio::io::AsyncWrite + Send + 'static) -> Pipe {
    let (reader, writer) = tokio::io::split(stream);
    Pipe { reader: Box::new(reader), writer: Box::new(writer) }
}
