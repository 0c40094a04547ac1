//! TCP transport. A device listens on port 1000 and accepts one client at a time.

use std::io;
use std::time::Duration;

use socket2::SockRef;
use tokio::net::TcpStream;
use url::Url;

use super::options::Options;
use super::{CONNECT_WITHIN, LinkProperties, Pipe, host_of};

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
    pub(super) fn parse(url: &Url) -> Result<Self, String> {
        Options::of(url, &[])?;
        let (host, port) = host_of(url, DEFAULT_PORT)?;
        Ok(Self { host, port })
    }

    pub(super) async fn connect(&self) -> io::Result<Pipe> {
        let connecting = TcpStream::connect((self.host.as_str(), self.port));
        let stream = tokio::time::timeout(CONNECT_WITHIN, connecting).await.map_err(|_| {
            let waited = CONNECT_WITHIN.as_secs();
            io::Error::new(io::ErrorKind::TimedOut, format!("no connection within {waited} s"))
        })??;
        // A small urgent frame must not wait for the acknowledgement of the previous one.
        stream.set_nodelay(true)?;
        let socket = SockRef::from(&stream).try_clone()?;
        let discard = move || {
            // The end of the connection is then a reset, which a gripper takes for an end without an announcement.
            let _ = socket.set_linger(Some(Duration::ZERO));
        };
        let (reader, writer) = stream.into_split();
        Ok(Pipe { discard_unsent: Some(Box::new(discard)), ..Pipe::new(reader, writer) })
    }
}
