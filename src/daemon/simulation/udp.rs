//! The device's end of UDP. It replies to a configured port of the last sender's host, whatever the sender's port was
//! (field practice).

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::UdpSocket;
use url::Url;

use super::super::listen::failed;
use crate::transport::{Options, Pipe, UdpAddress};
use crate::wsg::Opening;

/// The port that devices listen on, and the port that they reply to (field practice).
const DEFAULT_PORT: u16 = 1500;
const DEFAULT_REPLY_PORT: u16 = 1501;

pub(super) const OPTIONS: [&str; 1] = ["reply_port"];

/// The socket that the device listens on.
pub(super) struct Endpoint {
    socket: Arc<UdpSocket>,
    reply_port: u16,
}

impl Endpoint {
    /// Binds the socket of `udp://127.0.0.1:1500?reply_port=1501`.
    pub(super) async fn new(url: &Url) -> anyhow::Result<Self> {
        let options = Options::of(url, &OPTIONS).map_err(anyhow::Error::msg)?;
        let reply_port = options.port("reply_port").map_err(anyhow::Error::msg)?.unwrap_or(DEFAULT_REPLY_PORT);
        let host = url.host_str().unwrap_or_default().trim_start_matches('[').trim_end_matches(']');
        let socket = UdpSocket::bind((host, url.port().unwrap_or(DEFAULT_PORT))).await;
        let socket = socket.map_err(|error| failed("cannot listen", error))?;
        Ok(Self { socket: Arc::new(socket), reply_port })
    }

    pub(super) fn address(&self) -> io::Result<UdpAddress> {
        let address = self.socket.local_addr()?;
        let loopback = if address.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() };
        // A gateway on the same machine reaches a socket on all addresses at loopback.
        let host: IpAddr = if address.ip().is_unspecified() { loopback } else { address.ip() };
        Ok(UdpAddress::new(host.to_string(), address.port(), self.reply_port))
    }

    pub(super) fn open(&self) -> Pipe {
        let client = Arc::new(Mutex::new(None));
        let reader = Receiver { socket: self.socket.clone(), client: client.clone(), reply_port: self.reply_port };
        Pipe::new(reader, Sender { socket: self.socket.clone(), client })
    }
}

/// Address for replies: the host of the newest request, with the reply port.
type Client = Arc<Mutex<Option<SocketAddr>>>;

struct Receiver {
    socket: Arc<UdpSocket>,
    client: Client,
    reply_port: u16,
}

impl AsyncRead for Receiver {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, out: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        loop {
            let before = out.filled().len();
            let sender = ready!(self.socket.poll_recv_from(cx, out))?;
            if !Opening::begins_with_frame(out.filled().get(before..).unwrap_or_default()) {
                // A browser can send datagrams, too. An empty one does not mean end of file.
                out.set_filled(before);
                continue;
            }
            let client = SocketAddr::new(sender.ip(), self.reply_port);
            *self.client.lock().unwrap_or_else(PoisonError::into_inner) = Some(client);
            return Poll::Ready(Ok(()));
        }
    }
}

struct Sender {
    socket: Arc<UdpSocket>,
    client: Client,
}

impl AsyncWrite for Sender {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, frame: &[u8]) -> Poll<io::Result<usize>> {
        let client = *self.client.lock().unwrap_or_else(PoisonError::into_inner);
        match client {
            Some(client) => self.socket.poll_send_to(cx, frame, client),
            // No client has sent a request yet.
            None => Poll::Ready(Ok(frame.len())),
        }
    }

    fn poll_flush(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}
