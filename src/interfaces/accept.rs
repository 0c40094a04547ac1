//! Accepts the connections of interfaces with few, long-lived clients.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio::time::sleep;
use tokio_util::sync::CancellationToken;

use super::admission::Admission;

/// Pause after a failed accept: long enough not to spin while the process is out of file descriptors, short enough not
/// to be noticed.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Accepts clients until `draining`, and runs what `admit` returns for each. Returns the clients that are still served.
pub async fn each<F: Future<Output = ()> + Send + 'static>(
    listener: &TcpListener,
    admission: &Admission,
    draining: &CancellationToken,
    admit: impl Fn(TcpStream, SocketAddr) -> Option<F>,
) -> JoinSet<()> {
    let mut clients = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            biased;
            () = draining.cancelled() => return clients,
            Some(_) = clients.join_next() => continue,
            accepted = accept(listener, admission) => accepted,
        };
        match accepted {
            Ok((stream, peer)) => {
                if let Some(served) = admit(stream, peer) {
                    clients.spawn(served);
                }
            }
            Err(error) => {
                tracing::warn!(%error, "connection could not be accepted");
                admission.evict_one();
                sleep(ACCEPT_PAUSE).await;
            }
        }
    }
}

async fn accept(listener: &TcpListener, admission: &Admission) -> io::Result<(TcpStream, SocketAddr)> {
    admission.has_room().await;
    listener.accept().await
}
