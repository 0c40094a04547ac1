//! TCP transport. A device listens on port 1000 and accepts one client at a time.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use socket2::SockRef;
use tokio::time::Instant;
use url::Url;

use super::options::Options;
use super::{LinkProperties, Pipe, host, host_of};

/// Port that devices listen on (field practice; the manuals name none).
const DEFAULT_PORT: u16 = 1000;

/// TCP endpoint of a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TcpAddress {
    /// Host name or IP address.
    pub host: String,
    /// TCP port, 1000 by default.
    pub port: u16,
}

/// Covers a lost segment, which TCP retransmits after 200 ms or more: its frame is late, not damaged.
const FRAME_GAP: Duration = Duration::from_millis(500);

pub(super) const PROPERTIES: LinkProperties = LinkProperties {
    name: "tcp",
    connection_oriented: true,
    bytes_per_second: None,
    may_duplicate: false,
    frame_gap: FRAME_GAP,
};

impl TcpAddress {
    pub(super) fn parse(url: &Url, zone: Option<&str>) -> Result<Self, String> {
        Options::of(url, &[])?;
        let (host, port) = host_of(url, zone, DEFAULT_PORT)?;
        Ok(Self { host, port })
    }
}

/// Connects to the first of the device's addresses that accepts.
pub(super) async fn connect(addresses: &[SocketAddr], deadline: Instant) -> io::Result<Pipe> {
    let left = deadline.saturating_duration_since(Instant::now());
    let stream = host::connect_to_first(addresses, left).await?;
    // A small urgent frame must not wait for the acknowledgement of the previous one.
    stream.set_nodelay(true)?;
    let socket = SockRef::from(&stream).try_clone()?;
    let (reader, writer) = stream.into_split();
    Ok(Pipe {
        discard_unsent: Some(Box::new(move || {
            // The end of the connection is then a reset, which a gripper takes for an end without an announcement.
            let _ = socket.set_linger(Some(Duration::ZERO));
        })),
        ..Pipe::new(reader, writer)
    })
}
