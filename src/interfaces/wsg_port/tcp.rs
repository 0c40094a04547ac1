//! TCP clients, one connection each.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use socket2::SockRef;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;

use super::client::Served;
use super::opening::CheckedReader;
use super::port::{LOST_AFTER, Port};
use crate::connections::accept::{self, FastStopRule};
use crate::connections::admission::Admission;
use crate::connections::sockets;
use crate::wsg::frame::{OVERHEAD_BYTES, PREAMBLE};
use crate::wsg::id;
use crate::wsg::opening::MAX_NOISE_BYTES;

pub(super) async fn serve(
    port: Arc<Port>,
    listener: TcpListener,
    draining: CancellationToken,
    closing: CancellationToken,
) -> Option<TcpListener> {
    let admission = port.admission();
    let admitting = admission.clone();
    let ends = closing.clone();
    let clients = accept::each(&listener, &admission, &draining, FAST_STOP, move |stream, peer| {
        admit(&port, stream, peer, &admitting).map(|served| served.run(ends.clone()))
    });
    let mut clients = clients.await;
    let listener = closing.is_cancelled().then_some(listener);
    while clients.join_next().await.is_some() {}
    listener
}

const FAST_STOP: FastStopRule = FastStopRule { may_begin: begins_with_fast_stop, is_whole: begins_with_fast_stop };

/// Whether a connection begins with a whole FAST STOP, perhaps behind noise.
fn begins_with_fast_stop(first: &[u8]) -> bool {
    let begin = [&PREAMBLE[..], &[id::FAST_STOP]].concat();
    first.windows(OVERHEAD_BYTES).take(MAX_NOISE_BYTES + 1).any(|frame| frame.starts_with(&begin))
}

type Connection = Served<CheckedReader<OwnedReadHalf>, OwnedWriteHalf>;

fn admit(port: &Arc<Port>, stream: TcpStream, peer: SocketAddr, admission: &Arc<Admission>) -> Option<Connection> {
    let gripper = port.gripper.name();
    if !port.peers.allows(peer.ip()) {
        tracing::warn!(%gripper, %peer, "connection refused: add the address to wsg_port_allow or to a [[clients]] section");
        return None;
    }
    if let Err(error) = prepare(&stream) {
        // The connection has just ended.
        tracing::debug!(%gripper, %peer, %error, "connection refused: socket options could not be set");
        return None;
    }
    let permit = Port::admit(admission, peer);
    tracing::info!(%gripper, %peer, "WSG port client connected via TCP");
    let (reader, writer) = stream.into_split();
    let reader = CheckedReader::new(reader, port.clone(), peer);
    Some(Served::new(port.clone(), (port.client(peer.ip()), peer.ip()), permit, (reader, writer), None))
}

/// Makes each frame leave at once and on its own, and detects a vanished peer within [`LOST_AFTER`], even while frames
/// such as automatic updates are in flight to it.
fn prepare(stream: &TcpStream) -> io::Result<()> {
    sockets::prepare(stream)?;
    SockRef::from(stream).set_tcp_user_timeout(Some(LOST_AFTER))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn dead_peer_is_detected_within_three_seconds() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap());
        let (client, accepted) = tokio::join!(client, listener.accept());
        let (stream, _) = accepted.unwrap();
        prepare(&stream).unwrap();
        let socket = SockRef::from(&stream);
        assert_eq!(socket.tcp_user_timeout().unwrap(), Some(LOST_AFTER), "limit for unacknowledged data");
        assert!(socket.keepalive().unwrap() && socket.tcp_nodelay().unwrap());
        drop(client);
    }
}
