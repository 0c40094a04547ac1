//! UDP transport, one frame per datagram. A device listens on port 1500 and replies to a port configured on it,
//! commonly 1501, regardless of the sender's port (field practice; the manuals only mention UDP).
//!
//! A lost, late or duplicate datagram is a lost, late or duplicate frame, which the session handles. Datagrams from
//! other addresses are ignored.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::UdpSocket;
use url::Url;

use super::host::kind_of_no_device;
use super::options::Options;
use super::{LinkProperties, Pipe, host_of};

/// Port that devices listen on (field practice; the manuals name none).
const DEFAULT_PORT: u16 = 1500;

/// Port that devices reply to (field practice).
const DEFAULT_LOCAL_PORT: u16 = 1501;

/// A datagram contains its whole frame, so the rest of a truncated one never arrives. The gap still allows for a frame
/// in two datagrams, although no known device sends one.
const FRAME_GAP: Duration = Duration::from_millis(20);

const MAX_DATAGRAM_BYTES: usize = 65_535;

pub(super) const PROPERTIES: LinkProperties = LinkProperties {
    name: "udp",
    connection_oriented: false,
    bytes_per_second: None,
    may_duplicate: true,
    frame_gap: FRAME_GAP,
};

/// UDP endpoint of a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UdpAddress {
    /// Host name or IP address.
    pub host: String,
    /// Port that the device listens on, 1500 by default.
    pub port: u16,
    /// Local port that the device replies to, 1501 by default.
    pub local_port: u16,
    attempts: Attempts,
}

/// Number of connection attempts. Not part of the address: equality ignores it, and clones reset it.
#[derive(Debug, Default)]
struct Attempts(AtomicUsize);

impl Clone for Attempts {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl PartialEq for Attempts {
    fn eq(&self, _other: &Self) -> bool {
        true
    }
}

impl Eq for Attempts {}

impl UdpAddress {
    /// Address of a device that listens at `host` and `port`, and replies to `local_port`.
    #[must_use]
    pub fn new(host: String, port: u16, local_port: u16) -> Self {
        Self { host, port, local_port, attempts: Attempts::default() }
    }

    pub(super) fn parse(url: &Url, zone: Option<&str>) -> Result<Self, String> {
        let options = Options::of(url, &["local_port"])?;
        let (host, port) = host_of(url, zone, DEFAULT_PORT)?;
        let local_port = options.port("local_port")?.unwrap_or(DEFAULT_LOCAL_PORT);
        Ok(Self::new(host, port, local_port))
    }

    /// Opens the local port for a device with these addresses.
    pub(super) async fn connect(&self, addresses: &[SocketAddr]) -> io::Result<Pipe> {
        let device = self.choose(addresses.iter().copied()).await?;
        let socket = UdpSocket::bind((any(device), self.local_port)).await.map_err(|error| self.explain(&error))?;
        let socket = Arc::new(socket);
        let stranger = Arc::<OnceLock<IpAddr>>::default();
        let reader = Datagrams {
            socket: socket.clone(),
            device: device.ip(),
            datagram: Vec::new(),
            taken: 0,
            stranger: stranger.clone(),
        };
        Ok(Pipe { stranger, ..Pipe::new(reader, Sender { socket, device }) })
    }

    /// Chooses the next usable address of the host at each attempt, because UDP reports no failed connection.
    async fn choose(&self, addresses: impl Iterator<Item = SocketAddr>) -> io::Result<SocketAddr> {
        let mut usable = Vec::new();
        let mut unusable = Vec::new();
        for address in addresses {
            match try_out(address).await {
                Ok(()) => usable.push(address),
                Err(error) => unusable.push(format!("{} ({error})", address.ip())),
            }
        }
        if usable.is_empty() {
            let detail = format!("host {:?} has no usable address: {}", self.host, unusable.join(", "));
            return Err(io::Error::new(io::ErrorKind::AddrNotAvailable, detail));
        }
        let attempt = self.attempts.0.fetch_add(1, Ordering::Relaxed);
        Ok(usable[attempt % usable.len()])
    }

    fn explain(&self, error: &io::Error) -> io::Error {
        let port = self.local_port;
        let remedy = match error.kind() {
            io::ErrorKind::AddrInUse => {
                "another program or gripper uses the port: use a separate local_port for each gripper, and set the \
                 same port on the device"
            }
            io::ErrorKind::PermissionDenied => "ports below 1024 require privileges: use a higher local_port",
            _ => "use another local_port, and set the same port on the device",
        };
        io::Error::new(error.kind(), format!("cannot listen on UDP port {port} ({error}): {remedy}"))
    }
}

/// The unspecified address of the same family, to listen on all interfaces.
fn any(address: SocketAddr) -> IpAddr {
    if address.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() }
}

/// Checks that an address is usable. Sends nothing: the kernel looks up a route, and rejects broadcast addresses.
async fn try_out(address: SocketAddr) -> io::Result<()> {
    if let Some(kind) = kind_of_no_device(address.ip()) {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, kind));
    }
    let probe = UdpSocket::bind((any(address), 0)).await?;
    probe.connect(address).await.map_err(|error| match error.kind() {
        io::ErrorKind::PermissionDenied => io::Error::new(error.kind(), "a broadcast or blocked address"),
        _ => error,
    })
}

struct Datagrams {
    socket: Arc<UdpSocket>,
    device: IpAddr,
    /// Newest datagram; its first `taken` bytes have been read.
    datagram: Vec<u8>,
    taken: usize,
    /// First other address that a datagram came from.
    stranger: Arc<OnceLock<IpAddr>>,
}

impl AsyncRead for Datagrams {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, out: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        while this.taken == this.datagram.len() {
            this.taken = 0;
            this.datagram.resize(MAX_DATAGRAM_BYTES, 0);
            let mut datagram = ReadBuf::new(&mut this.datagram);
            let received = this.socket.poll_recv_from(cx, &mut datagram);
            let bytes = datagram.filled().len();
            let sender = match &received {
                Poll::Ready(Ok(sender)) => Some(sender.ip().to_canonical()),
                _ => None,
            };
            let believed = sender == Some(this.device.to_canonical());
            this.datagram.truncate(if believed { bytes } else { 0 });
            let sender = ready!(received)?;
            if !believed {
                this.stranger.get_or_init(|| sender.ip().to_canonical());
                tracing::debug!(%sender, device = %this.device, "ignored datagram from another address");
            }
        }
        let bytes = out.remaining().min(this.datagram.len() - this.taken);
        out.put_slice(&this.datagram[this.taken..this.taken + bytes]);
        this.taken += bytes;
        Poll::Ready(Ok(()))
    }
}

/// Sends each write as one datagram.
struct Sender {
    socket: Arc<UdpSocket>,
    device: SocketAddr,
}

impl AsyncWrite for Sender {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, frame: &[u8]) -> Poll<io::Result<usize>> {
        self.socket.poll_send_to(cx, frame, self.device)
    }

    fn poll_flush(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::super::Address;
    use super::*;

    fn at(host: &str, port: u16, local_port: u16) -> UdpAddress {
        UdpAddress::new(host.to_owned(), port, local_port)
    }

    async fn free_port() -> u16 {
        UdpSocket::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap().port()
    }

    async fn pair() -> (UdpSocket, Pipe, u16) {
        let device = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let port = device.local_addr().unwrap().port();
        let local_port = free_port().await;
        let pipe = Address::Udp(at("127.0.0.1", port, local_port)).connect().await.unwrap();
        (device, pipe, local_port)
    }

    #[tokio::test]
    async fn sends_datagrams_and_receives_from_any_port_of_device() {
        let (device, mut pipe, local_port) = pair().await;
        pipe.writer.write_all(b"first").await.unwrap();
        pipe.writer.write_all(b"second").await.unwrap();
        let mut buffer = [0; 100];
        let (bytes, sender) = device.recv_from(&mut buffer).await.unwrap();
        assert_eq!((&buffer[..bytes], sender.port()), (&b"first"[..], local_port));
        assert_eq!(device.recv(&mut buffer).await.unwrap(), 6);

        let other_port = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        other_port.send_to(b"an answer", ("127.0.0.1", local_port)).await.unwrap();
        let bytes = pipe.reader.read(&mut buffer[..2]).await.unwrap();
        assert_eq!(&buffer[..bytes], b"an");
        let bytes = pipe.reader.read(&mut buffer).await.unwrap();
        assert_eq!(&buffer[..bytes], b" answer", "a short read loses nothing");
    }

    #[tokio::test]
    async fn ignores_other_addresses_and_empty_datagrams() {
        let (device, mut pipe, local_port) = pair().await;
        let stranger = UdpSocket::bind("127.0.0.2:0").await.unwrap();
        stranger.send_to(b"believe me", ("127.0.0.1", local_port)).await.unwrap();
        device.send_to(b"", ("127.0.0.1", local_port)).await.unwrap();
        device.send_to(b"true", ("127.0.0.1", local_port)).await.unwrap();
        let mut buffer = [0; 100];
        let bytes = pipe.reader.read(&mut buffer).await.unwrap();
        assert_eq!(&buffer[..bytes], b"true");
        assert_eq!(pipe.stranger.get().unwrap().to_string(), "127.0.0.2");
    }

    #[tokio::test]
    async fn port_in_use_error_names_remedy() {
        let (_device, _pipe, local_port) = pair().await;
        let error = Address::Udp(at("127.0.0.1", 1500, local_port)).connect().await.unwrap_err().to_string();
        assert!(error.contains(&local_port.to_string()) && error.contains("separate local_port"), "{error}");
    }
    #[tokio::test]
    async fn usable_addresses_of_a_name_are_tried_in_turn() {
        let name = at("gripper", 1500, 1501);
        let addresses: Vec<SocketAddr> =
            ["127.255.255.255:9", "127.0.0.3:9", "[ff02::1]:9", "127.0.0.4:9"].map(|text| text.parse().unwrap()).into();
        let mut chosen = Vec::new();
        for _ in 0..4 {
            chosen.push(name.choose(addresses.iter().copied()).await.unwrap().ip().to_string());
        }
        assert_eq!(chosen, ["127.0.0.3", "127.0.0.4", "127.0.0.3", "127.0.0.4"]);
        let error = name.choose(addresses.into_iter().step_by(2)).await.unwrap_err().to_string();
        assert!(error.contains("127.255.255.255 (a broadcast") && error.contains("ff02::1 (a multicast"), "{error}");
    }

    #[tokio::test]
    async fn receives_from_device_that_appears_later() {
        let (device, mut pipe, local_port) = pair().await;
        let address = device.local_addr().unwrap();
        drop(device);
        // The kernel reports an unreachable port each time; the pipe must survive the errors.
        for _ in 0..3 {
            pipe.writer.write_all(b"nobody").await.unwrap();
        }
        let device = UdpSocket::bind(address).await.unwrap();
        device.send_to(b"here", ("127.0.0.1", local_port)).await.unwrap();
        let mut buffer = [0; 100];
        let bytes = pipe.reader.read(&mut buffer).await.unwrap();
        assert_eq!(&buffer[..bytes], b"here");
    }
}
