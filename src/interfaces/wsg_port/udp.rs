//! UDP clients. A client is identified by the address that its replies go to, and is lost when it is silent for too
//! long.

use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::UdpSocket;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use super::client::Served;
use super::port::Port;

/// Settings for UDP clients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Datagrams {
    /// Port that replies go to, like those of devices; the sender's port if `None`.
    pub reply_port: Option<u16>,
    /// Silence after which a client is lost.
    pub lost_after: Duration,
}

const MAX_DATAGRAM_BYTES: usize = 65_535;

/// Maximum number of unread datagrams of one client. More are dropped, as UDP allows.
const MAX_WAITING_DATAGRAMS: usize = 32;

pub(super) async fn serve(
    port: Arc<Port>,
    socket: UdpSocket,
    Datagrams { reply_port, lost_after }: Datagrams,
    draining: CancellationToken,
    closing: CancellationToken,
) {
    let (socket, admission) = (Arc::new(socket), port.admission());
    let (mut known, mut clients) = (HashMap::<SocketAddr, mpsc::Sender<Vec<u8>>>::new(), JoinSet::new());
    let mut datagram = vec![0; MAX_DATAGRAM_BYTES];
    loop {
        let received = tokio::select! {
            biased;
            () = closing.cancelled() => break,
            Some(_) = clients.join_next() => {
                known.retain(|_, client| !client.is_closed());
                continue;
            }
            received = socket.recv_from(&mut datagram) => received,
        };
        // An error refers to an earlier reply, whose client will be silent.
        let Ok((bytes, peer)) = received else { continue };
        let bytes = datagram.get(..bytes).unwrap_or_default().to_vec();
        // All senders with the same reply address are one client, since their replies could not be distinguished.
        let answered_at = SocketAddr::new(peer.ip(), reply_port.unwrap_or(peer.port()));
        let client = known.get(&answered_at).filter(|client| !client.is_closed()).cloned();
        let client = match client {
            Some(client) => client,
            None if draining.is_cancelled() => continue,
            None if !port.allows(peer.ip()) => {
                let gripper = port.gripper.name();
                tracing::debug!(%gripper, %peer, "datagram ignored: address not in wsg_port_allow");
                continue;
            }
            // Evicted clients end within milliseconds; the sender repeats a datagram that is lost meanwhile.
            None if admission.is_crowded() => continue,
            None => {
                let permit = Port::admit(&admission, peer);
                tracing::info!(gripper = %port.gripper.name(), %peer, "WSG port client connected via UDP");
                let (sender, datagrams) = mpsc::channel(MAX_WAITING_DATAGRAMS);
                let writer = Writer { socket: socket.clone(), peer: answered_at };
                let reader = Reader { datagrams, rest: Vec::new() };
                let client = Port::client(peer);
                let served = Served::new(port.clone(), client, permit, (reader, writer), Some(lost_after));
                clients.spawn(served.run(closing.clone()));
                known.insert(answered_at, sender.clone());
                sender
            }
        };
        // A full queue means that the client sends too fast: drop the datagram.
        let _ = client.try_send(bytes);
    }
    while clients.join_next().await.is_some() {}
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
}

impl AsyncWrite for Writer {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, frame: &[u8]) -> Poll<io::Result<usize>> {
        // A failed send is a lost datagram; a vanished client is detected by its silence.
        let _ = ready!(self.socket.poll_send_to(cx, frame, self.peer));
        Poll::Ready(Ok(frame.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}
