//! Clients by TCP: a connection each.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use socket2::SockRef;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio::time::sleep;
use tokio_util::sync::CancellationToken;

use super::client::Served;
use super::port::{LOST_AFTER, Port};
use crate::interfaces::admission::Admission;
use crate::interfaces::sockets;

/// How long no connection is accepted after that failed: long enough not to spin while the process is out of file
/// descriptors, short enough not to be noticed.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

pub(super) async fn serve(
    port: Arc<Port>,
    listener: TcpListener,
    draining: CancellationToken,
    closing: CancellationToken,
) {
    let (admission, mut clients) = (port.admission(), JoinSet::new());
    loop {
        let accepted = tokio::select! {
            biased;
            () = draining.cancelled() => break,
            Some(_) = clients.join_next() => continue,
            accepted = accept(&listener, &admission) => accepted,
        };
        match accepted {
            Ok((stream, peer)) => {
                if let Some(served) = admit(&port, stream, peer, &admission) {
                    clients.spawn(served.run(closing.clone()));
                }
            }
            Err(error) => {
                tracing::warn!(%error, "connection could not be accepted");
                admission.evict_one();
                sleep(ACCEPT_PAUSE).await;
            }
        }
    }
    drop(listener);
    while clients.join_next().await.is_some() {}
}

async fn accept(listener: &TcpListener, admission: &Admission) -> io::Result<(TcpStream, SocketAddr)> {
    admission.has_room().await;
    listener.accept().await
}

type Connection = Served<tokio::net::tcp::OwnedReadHalf, tokio::net::tcp::OwnedWriteHalf>;

fn admit(port: &Arc<Port>, stream: TcpStream, peer: SocketAddr, admission: &Arc<Admission>) -> Option<Connection> {
    let gripper = port.gripper.name();
    if !port.allows(peer.ip()) {
        tracing::warn!(%gripper, %peer, "connection refused: wsg_port_allow does not name its address");
        return None;
    }
    if let Err(error) = prepare(&stream) {
        // It has just ended.
        tracing::debug!(%gripper, %peer, %error, "connection refused: its options could not be set");
        return None;
    }
    let permit = Port::admit(admission, peer);
    tracing::info!(%gripper, %peer, "connected to the WSG port");
    let (reader, writer) = stream.into_split();
    Some(Served::new(port.clone(), Port::client(peer), permit, (reader, writer), None))
}

/// Each frame leaves at once and by itself, and a peer that is gone without a word is noticed within [`LOST_AFTER`]:
/// also one to which frames are on their way, as automatic updates always are.
fn prepare(stream: &TcpStream) -> io::Result<()> {
    sockets::prepare(stream)?;
    SockRef::from(stream).set_tcp_user_timeout(Some(LOST_AFTER))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_dead_peer_is_found_within_three_seconds() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap());
        let (client, accepted) = tokio::join!(client, listener.accept());
        let (stream, _) = accepted.unwrap();
        prepare(&stream).unwrap();
        let socket = SockRef::from(&stream);
        assert_eq!(socket.tcp_user_timeout().unwrap(), Some(LOST_AFTER), "of what was sent and not acknowledged");
        assert!(socket.keepalive().unwrap() && socket.tcp_nodelay().unwrap());
        drop(client);
    }
}
