//! UDP clients. A client is identified by the address that its replies go to.
//!
//! Each datagram has to begin with a frame, since another program of a client's host can send to the same port.
//!
//! Silence ends a client's lease, but not its updates: many drivers only listen while they hold a part. A client is
//! removed after its 07h, when its port is closed, when its host is unreachable for too long, or when another program
//! uses its address.

use std::collections::{BTreeSet, HashMap};
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::UdpSocket;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use super::client::Served;
use super::port::Port;
use super::unreachable::{self, DeliveryError, Outage};
use crate::connections::admission;
use crate::model::clock;
use crate::wsg::Opening;

/// Settings for UDP clients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Datagrams {
    /// Port that replies go to, like those of devices; the sender's port if `None`.
    pub reply_port: Option<u16>,
    /// Silence after which a client's lease is lost.
    pub lost_after: Duration,
}

const MAX_DATAGRAM_BYTES: usize = 65_535;

/// Maximum number of unread datagrams of one client. More are dropped, as UDP allows.
const MAX_WAITING_DATAGRAMS: usize = 32;

/// Maximum number of hosts with a warning in the log. A port rarely has more than a few.
const MAX_WARNED: usize = 64;

/// A client and its task.
struct UdpClient {
    datagrams: mpsc::Sender<Vec<u8>>,
    /// Port that the client sends from.
    source: u16,
    heard: Instant,
    /// Errors reported since the client was heard.
    outage: Outage,
}

/// Hosts that were already warned about in the log.
#[derive(Default)]
struct WarnedHosts(BTreeSet<IpAddr>);

impl WarnedHosts {
    /// Whether this is the first warning for the host.
    fn is_first(&mut self, host: IpAddr) -> bool {
        self.0.len() < MAX_WARNED && self.0.insert(admission::peer(host))
    }
}

pub(super) async fn serve(
    port: Arc<Port>,
    socket: UdpSocket,
    Datagrams { reply_port, lost_after }: Datagrams,
    draining: CancellationToken,
    closing: CancellationToken,
) -> Option<UdpSocket> {
    let socket = Arc::new(socket);
    let admission = port.admission();
    unreachable::report(&socket);
    let mut known = HashMap::<SocketAddr, UdpClient>::new();
    let mut clients = JoinSet::new();
    let mut ignored = WarnedHosts::default();
    let mut unheard = WarnedHosts::default();
    let mut foreign = WarnedHosts::default();
    let mut datagram = vec![0; MAX_DATAGRAM_BYTES];
    let gripper = port.gripper.name();
    loop {
        let received = tokio::select! {
            biased;
            () = closing.cancelled() => break,
            Some(_) = clients.join_next() => {
                known.retain(|_, client| !client.datagrams.is_closed());
                continue;
            }
            (address, error) = unreachable::next(&socket) => {
                let Some(client) = known.get_mut(&address) else { continue };
                let cause = match error {
                    DeliveryError::Closed => "its port is closed",
                    DeliveryError::Unreachable if client.outage.is_loss(clock::instant()) => "its host is unreachable",
                    DeliveryError::Unreachable => continue,
                };
                tracing::info!(%gripper, client = %address, "client lost: {cause}");
                let is_elsewhere = error == DeliveryError::Closed && client.source != address.port();
                if is_elsewhere && unheard.is_first(address.ip()) {
                    tracing::warn!(%gripper, client = %address, source = client.source,
                        "replies reach nobody: if the driver expects them at the port that it sends from, add \
                         reply_port=sender to the address in wsg_port");
                }
                // The client's task ends once its sender is dropped.
                known.remove(&address);
                continue;
            }
            received = socket.recv_from(&mut datagram) => received,
        };
        // An error refers to an earlier reply.
        let Ok((bytes, peer)) = received else { continue };
        let bytes = datagram.get(..bytes).unwrap_or_default().to_vec();
        // Also of a known client: with a fixed reply port, a browser on its machine would count as the same client.
        if !Opening::begins_with_frame(&bytes) {
            let is_first = foreign.is_first(peer.ip());
            port.metrics.foreign.ignored(peer, &bytes, is_first);
            continue;
        }
        // All senders with the same reply address are one client, since their replies could not be distinguished.
        let answered_at = SocketAddr::new(peer.ip(), reply_port.unwrap_or(peer.port()));
        let now = clock::instant();
        // After a silence, another source port means another program, which has not requested the client's updates.
        let client = known
            .get_mut(&answered_at)
            .filter(|client| !client.datagrams.is_closed())
            .filter(|client| client.source == peer.port() || now < client.heard + lost_after);
        if let Some(client) = client {
            (client.source, client.heard, client.outage) = (peer.port(), now, Outage::default());
            // A full queue means that the client sends too fast: drop the datagram.
            let _ = client.datagrams.try_send(bytes);
            continue;
        }
        if draining.is_cancelled() {
            continue;
        }
        if !port.peers.allows(peer.ip()) {
            if ignored.is_first(peer.ip()) {
                tracing::warn!(%gripper, %peer, "datagrams ignored: add the address to wsg_port_allow or to a [[clients]] section");
            }
            continue;
        }
        // Evicted clients end within milliseconds; the sender repeats a datagram that is lost meanwhile.
        if admission.is_crowded() {
            continue;
        }
        let permit = Port::admit(&admission, peer);
        tracing::info!(%gripper, %peer, replies_to = %answered_at, "WSG port client connected via UDP");
        let (sender, datagrams) = mpsc::channel(MAX_WAITING_DATAGRAMS);
        // The new queue has room.
        let _ = sender.try_send(bytes);
        let writer = Writer { socket: socket.clone(), peer: answered_at, outage: Outage::default() };
        let reader = Reader { datagrams, rest: Vec::new() };
        let served =
            Served::new(port.clone(), (port.client(peer.ip()), peer.ip()), permit, (reader, writer), Some(lost_after));
        clients.spawn(served.run(closing.clone()));
        let outage = Outage::default();
        known.insert(answered_at, UdpClient { datagrams: sender, source: peer.port(), heard: now, outage });
    }
    while clients.join_next().await.is_some() {}
    Arc::into_inner(socket)
}

/// Reads one client's datagrams as a stream.
struct Reader {
    datagrams: mpsc::Receiver<Vec<u8>>,
    rest: Vec<u8>,
}

impl AsyncRead for Reader {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, out: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        // Skip empty datagrams: an empty read would mean the end of the stream.
        while self.rest.is_empty() {
            match ready!(self.datagrams.poll_recv(cx)) {
                Some(datagram) => self.rest = datagram,
                None => return Poll::Ready(Ok(())),
            }
        }
        let taken = self.rest.len().min(out.remaining());
        out.put_slice(self.rest.get(..taken).unwrap_or_default());
        self.rest.drain(..taken);
        Poll::Ready(Ok(()))
    }
}

/// Sends one client its frames, one datagram each.
struct Writer {
    socket: Arc<UdpSocket>,
    peer: SocketAddr,
    /// Errors of this machine since a datagram was sent, such as a missing route.
    outage: Outage,
}

impl AsyncWrite for Writer {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, frame: &[u8]) -> Poll<io::Result<usize>> {
        let mut sent = ready!(self.socket.poll_send_to(cx, frame, self.peer));
        if sent.is_err() {
            // The error may be that of an earlier datagram, perhaps to another client.
            sent = ready!(self.socket.poll_send_to(cx, frame, self.peer));
        }
        match sent {
            Err(error) if self.outage.is_loss(clock::instant()) => {
                tracing::info!(client = %self.peer, %error, "client lost: datagrams to it cannot be sent");
                return Poll::Ready(Err(error));
            }
            // A failed send is a lost datagram.
            Err(_) => {}
            Ok(_) => self.outage = Outage::default(),
        }
        Poll::Ready(Ok(frame.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::io::AsyncWriteExt as _;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn client_without_a_route_is_lost() {
        // A socket of the loopback interface cannot send to another host.
        let socket = Arc::new(UdpSocket::bind("127.0.0.1:0").await.unwrap());
        let mut writer = Writer { socket, peer: "192.0.2.1:1501".parse().unwrap(), outage: Outage::default() };
        for _ in 0..12 {
            assert_eq!(writer.write(b"frame").await.unwrap(), 5, "lost like any datagram");
            tokio::time::advance(Duration::from_secs(10)).await;
        }
        assert!(writer.write(b"frame").await.is_err());
    }
}
