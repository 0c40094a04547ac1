//! Clients' TCP connections, at whichever door, and what helps where they can't come in.

use std::io::{self, ErrorKind};
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};
use tokio::net::TcpStream;

/// A client that doesn't acknowledge its TCP segments for so long is lost.
pub const LOST_AFTER: Duration = Duration::from_secs(3);

/// How often a silent peer is asked whether it is still there.
const PROBE_EVERY: Duration = Duration::from_secs(1);

/// What is written leaves at once, and a peer that is gone without a word while nothing is on its way to it is noticed
/// within [`LOST_AFTER`]. What is on its way to one that doesn't read may go on waiting.
///
/// # Errors
/// Where the connection has just ended.
pub fn prepare(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let keepalive = TcpKeepalive::new().with_time(PROBE_EVERY).with_interval(PROBE_EVERY).with_retries(2);
    SockRef::from(stream).set_tcp_keepalive(&keepalive)
}

/// What helps where an address can't be listened on.
#[must_use]
pub fn remedy(error: ErrorKind) -> &'static str {
    match error {
        ErrorKind::AddrInUse => "choose another address, or end what listens there",
        ErrorKind::PermissionDenied => {
            "a port below 1024 needs a privilege: choose a higher one, or give the program CAP_NET_BIND_SERVICE"
        }
        ErrorKind::AddrNotAvailable => "this machine has no such address: choose one that it has",
        _ => "choose another address",
    }
}

#[cfg(test)]
mod tests {
    use tokio::net::TcpListener;

    use super::*;

    #[tokio::test]
    async fn a_dead_peer_is_found_within_three_seconds() {
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
