//! Dead UDP clients. The host of a dead client answers a datagram to the closed port with an ICMP error.

use std::future::pending;
use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::os::fd::{AsRawFd, RawFd};

use rustix::net::{RecvFlags, recvfrom};
use socketcan::SocketOptions as _;
use tokio::io::Interest;
use tokio::net::UdpSocket;

/// `IP_RECVERR` and `IPV6_RECVERR` of Linux, each with its level.
const REPORT_ERRORS: [(i32, i32); 2] = [(0, 11), (41, 25)];

/// A socket whose options are set by number.
struct NumberedOptions(RawFd);

impl AsRawFd for NumberedOptions {
    fn as_raw_fd(&self) -> RawFd {
        self.0
    }
}

impl socketcan::SocketOptions for NumberedOptions {}

/// Makes the socket keep ICMP errors for [`next`].
pub(super) fn report(socket: &UdpSocket) {
    let options = NumberedOptions(socket.as_raw_fd());
    // IPv4 sockets refuse the option of IPv6. Without both options, only silence shows that a client is dead.
    for (level, option) in REPORT_ERRORS {
        let _ = options.set_socket_option_int(level, option, 1);
    }
}

/// Returns the address of the next client whose port was found closed.
pub(super) async fn next(socket: &UdpSocket) -> SocketAddr {
    loop {
        match socket.async_io(Interest::ERROR, || dequeue(socket)).await {
            Ok(Some(address)) => return address,
            Ok(None) => {}
            Err(error) => {
                tracing::warn!(%error, "ICMP errors cannot be read: dead UDP clients are noticed by their silence");
                return pending().await;
            }
        }
    }
}

/// Takes an error from the socket's queue. Errors other than a closed port can be temporary, and are ignored.
fn dequeue(socket: &UdpSocket) -> io::Result<Option<SocketAddr>> {
    let is_closed = matches!(socket.take_error(), Ok(Some(error)) if error.kind() == ErrorKind::ConnectionRefused);
    let (_, _, address) = recvfrom(socket, &mut [0_u8; 1], RecvFlags::ERRQUEUE | RecvFlags::DONTWAIT)?;
    Ok(address.filter(|_| is_closed).and_then(|address| SocketAddr::try_from(address).ok()))
}
