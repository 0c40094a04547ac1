//! Options of clients' TCP connections, and remedies for listeners that fail.

use std::io::{self, ErrorKind};
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};
use tokio::net::TcpStream;

/// Time without TCP acknowledgements after which a client is lost.
pub const LOST_AFTER: Duration = Duration::from_secs(3);

/// Interval of keep-alive probes to a silent peer.
const PROBE_EVERY: Duration = Duration::from_secs(1);

/// Makes written data leave at once, and detects a vanished peer within [`LOST_AFTER`] if no data is in flight to it.
/// Data in flight to a peer that does not read can keep waiting.
pub fn prepare(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let keepalive = TcpKeepalive::new().with_time(PROBE_EVERY).with_interval(PROBE_EVERY).with_retries(2);
    SockRef::from(stream).set_tcp_keepalive(&keepalive)
}

/// Returns the remedy for an address that can't be listened on.
#[must_use]
pub fn remedy(error: ErrorKind) -> &'static str {
    match error {
        ErrorKind::AddrInUse => "choose another address, or stop the program that listens there",
        ErrorKind::PermissionDenied => {
            "ports below 1024 need a privilege: choose a higher port, or give the program CAP_NET_BIND_SERVICE"
        }
        ErrorKind::AddrNotAvailable => "this machine does not have that address: choose one of its own",
        _ => "choose another address",
    }
}

#[cfg(test)]
mod tests {
    use tokio::net::TcpListener;

    use super::*;

    #[tokio::test]
    async fn dead_peer_is_detected_within_three_seconds() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap());
        let (client, accepted) = tokio::join!(client, listener.accept());
        let (stream, _) = accepted.unwrap();
        prepare(&stream).unwrap();
        let socket = SockRef::from(&stream);
        let probes = socket.tcp_keepalive_retries().unwrap() * PROBE_EVERY.as_secs() as u32;
        let idle = socket.tcp_keepalive_time().unwrap();
        assert_eq!(socket.tcp_keepalive_interval().unwrap(), PROBE_EVERY);
        assert_eq!(idle + Duration::from_secs(probes.into()), LOST_AFTER);
        assert!(socket.keepalive().unwrap() && socket.tcp_nodelay().unwrap());
        drop(client);
    }
}
