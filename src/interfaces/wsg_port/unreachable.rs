//! Dead UDP clients. The host of a dead client answers a datagram to the closed port with an ICMP error. If the host or
//! the network is gone, a router or this machine reports that instead.

use std::future::pending;
use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::os::fd::{AsRawFd, RawFd};
use std::time::{Duration, Instant};

use rustix::net::{RecvFlags, recvfrom};
use socketcan::SocketOptions as _;
use tokio::io::Interest;
use tokio::net::UdpSocket;

/// `IP_RECVERR` and `IPV6_RECVERR` of Linux, each with its level.
const REPORT_ERRORS: [(i32, i32); 2] = [(0, 11), (41, 25)];

/// Time for which a client can be unreachable before it is lost. Within this time, a switch restarts or a cable is
/// replaced, and a driver that only listens must then get its updates again.
const LOST_AFTER: Duration = Duration::from_mins(2);

/// Longest time between two errors of one outage: longer than the longest period of updates.
const SAME_OUTAGE: Duration = Duration::from_secs(70);

/// Error of an earlier datagram to a client.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DeliveryError {
    /// The port is closed, so that the program is gone.
    Closed,
    /// The host or the network cannot be reached, perhaps only for a while.
    Unreachable,
}

/// Time for which a client has been unreachable.
#[derive(Debug, Default)]
pub(super) struct Outage(Option<OutageTimes>);

#[derive(Debug, Clone, Copy)]
struct OutageTimes {
    begin: Instant,
    newest: Instant,
}

impl Outage {
    /// Notes an error. Returns whether the client is lost.
    pub(super) fn is_loss(&mut self, now: Instant) -> bool {
        let same = self.0.filter(|times| now < times.newest + SAME_OUTAGE);
        let begin = same.map_or(now, |times| times.begin);
        self.0 = Some(OutageTimes { begin, newest: now });
        now >= begin + LOST_AFTER
    }
}

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

/// Returns the next client that a datagram did not reach.
pub(super) async fn next(socket: &UdpSocket) -> (SocketAddr, DeliveryError) {
    loop {
        match socket.async_io(Interest::ERROR, || dequeue(socket)).await {
            Ok(Some(undelivered)) => return undelivered,
            Ok(None) => {}
            Err(error) => {
                tracing::warn!(%error, "ICMP errors cannot be read: dead UDP clients are noticed by their silence");
                return pending().await;
            }
        }
    }
}

/// Takes an error from the socket's queue. The socket itself tells the kind, unless a failed send has taken it: then
/// the error counts as an outage, and a closed port is found by the next datagram.
fn dequeue(socket: &UdpSocket) -> io::Result<Option<(SocketAddr, DeliveryError)>> {
    let is_closed = matches!(socket.take_error(), Ok(Some(error)) if error.kind() == ErrorKind::ConnectionRefused);
    let (_, _, address) = recvfrom(socket, &mut [0_u8; 1], RecvFlags::ERRQUEUE | RecvFlags::DONTWAIT)?;
    let error = if is_closed { DeliveryError::Closed } else { DeliveryError::Unreachable };
    Ok(address.and_then(|address| Some((SocketAddr::try_from(address).ok()?, error))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_lasting_outage_is_a_loss() {
        let begin = Instant::now();
        for (errors_at_s, expected) in [
            (vec![0, 3, 60, 119], false),
            (vec![0, 3, 60, 120], true),
            (vec![0, 65, 130], true),
            (vec![0, 60, 140, 200], false),
        ] {
            let mut outage = Outage::default();
            let mut is_lost = false;
            for at_s in &errors_at_s {
                is_lost = outage.is_loss(begin + Duration::from_secs(*at_s));
            }
            assert_eq!(is_lost, expected, "{errors_at_s:?}");
        }
    }
}
