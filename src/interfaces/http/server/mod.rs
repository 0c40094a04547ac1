//! The HTTP server: accepts connections, and serves each on the matching runtime.
//!
//! `axum::serve` bounds neither connections nor the time for a request's header, so this builds on hyper. [`Admission`]
//! admits connections. The server inspects the first bytes of each. A connection that begins with a whole FAST STOP is served
//! on the accepting runtime, which does nothing else; all others move to
//! [`Runtimes::requests`](crate::connections::Runtimes::requests). A connection that streams updates moves to
//! [`Runtimes::observers`](crate::connections::Runtimes::observers).

mod connection;
mod inspection;
mod redirect;
pub(super) mod runtime_mover;

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio::time::{sleep, timeout};
use tokio_util::sync::CancellationToken;

use super::context::HttpContext;
use super::http_settings::HttpSettings;
use super::requests::fast_stop::{begins_with_fast_stop, may_be_fast_stop};
use super::requests::requested_operation::OperationPaths;
use super::router::router;
use crate::connections::accept::{self, Acceptor, CrowdSlot, FastStopRule};
use crate::connections::admission::{Admission, ConnectionPermit, Usage};
use crate::connections::handshakes::Handshakes;
use crate::connections::metrics::Connected;
use connection::Server;
pub use connection::ServerLimits;
use inspection::{Begun, Inspected, decrypt, inspect};

/// Extra time that the server waits for its connections beyond their own shutdown time.
const SHUTDOWN_SLACK: Duration = Duration::from_millis(100);

/// Time for a TLS handshake and the first line behind it while too many connections are leaving.
const HANDSHAKE_IN_CROWD: Duration = Duration::from_millis(500);

/// Returns a listener on this address, on the caller's runtime.
pub fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    TcpListener::from_std(accept::listen(address)?)
}

/// The listener, which a reload can replace.
pub type Listeners = watch::Receiver<Arc<TcpListener>>;

/// Serves until `shutdown`, then finishes the running requests.
pub async fn serve(listeners: Listeners, context: Arc<HttpContext>, limits: ServerLimits, shutdown: CancellationToken) {
    let admission = Admission::new(limits.bounds);
    if let Err(error) = Usage::register(&context.registry, "http", &admission) {
        tracing::warn!(%error, "connection metrics unavailable");
    }
    let server = Arc::new(Server {
        router: router(&context),
        paths: OperationPaths::default(),
        admission,
        limits,
        handshakes: Handshakes::default(),
        closing: shutdown.child_token(),
        context,
    });
    tokio::select! {
        biased;
        () = shutdown.cancelled() => {}
        () = server.accept_all(listeners) => {}
    }
    // Each connection has a bound of its own on its end: this timeout covers a connection that hangs anyway.
    if timeout(limits.shutdown_time + SHUTDOWN_SLACK, server.admission.all_ended()).await.is_err() {
        tracing::warn!("connections closed before their requests were answered");
    }
}

const FAST_STOP: FastStopRule = FastStopRule { may_begin: may_be_fast_stop, is_whole: begins_with_fast_stop };

impl Server {
    async fn accept_all(self: &Arc<Self>, mut listeners: Listeners) {
        let mut acceptor = Acceptor::default();
        let mut listener = listeners.borrow_and_update().clone();
        loop {
            acceptor.ready(&self.admission).await;
            let accepted = tokio::select! {
                biased;
                accepted = listener.accept() => accepted,
                Ok(()) = listeners.changed() => {
                    listener = listeners.borrow_and_update().clone();
                    continue;
                }
            };
            match accepted {
                Ok((stream, peer)) if self.admission.is_crowded() => {
                    // Evicted connections end on the request runtimes, which can be busy. A FAST STOP must not wait for
                    // them.
                    self.await_fast_stop(stream, peer).await;
                }
                Ok((stream, peer)) => {
                    let permit = self.admit(peer);
                    let connected = self.context.metrics.connected();
                    tokio::spawn(self.clone().begin(stream, peer, permit, connected));
                }
                Err(error) => acceptor.failed(&self.admission, error).await,
            }
        }
    }

    /// Keeps a connection that has found no room for a moment, if it has a slot: up to [`accept::FIRST_BYTES_WITHIN`], with
    /// TLS [`HANDSHAKE_IN_CROWD`]. It is served if it begins with a FAST STOP.
    async fn await_fast_stop(self: &Arc<Self>, stream: TcpStream, peer: SocketAddr) {
        let settings = self.context.settings.get();
        if settings.tls.is_some() {
            if let Some(slot) = self.admission.reserved(false).or_else(|| self.admission.lasting()) {
                tokio::spawn(self.clone().decrypt_in_crowd(settings, stream, peer, slot));
            }
        } else if let Some(slot) = accept::slot_in_crowd(&self.admission, &stream, FAST_STOP).await {
            self.inspect_in_crowd(stream, peer, slot);
        }
    }

    /// Inspects a connection in a task of its own.
    fn inspect_in_crowd(self: &Arc<Self>, stream: TcpStream, peer: SocketAddr, slot: CrowdSlot) {
        tokio::spawn(self.clone().admit_fast_stop(stream, peer, slot));
    }

    /// Admits a connection only if it begins with a FAST STOP.
    async fn admit_fast_stop(self: Arc<Self>, stream: TcpStream, peer: SocketAddr, slot: CrowdSlot) {
        let slot = accept::fast_stop_in_crowd(&self.admission, &stream, slot, FAST_STOP).await;
        if slot.is_some() {
            self.clone().begin(stream, peer, self.admit(peer), self.context.metrics.connected()).await;
        }
    }

    /// Admits a connection with TLS only if it begins with a FAST STOP.
    async fn decrypt_in_crowd(
        self: Arc<Self>,
        settings: Arc<HttpSettings>,
        stream: TcpStream,
        peer: SocketAddr,
        slot: OwnedSemaphorePermit,
    ) {
        let begun = timeout(HANDSHAKE_IN_CROWD, self.decrypted(settings, stream, peer)).await;
        if let Some(begun) = begun.ok().flatten().filter(|begun| begun.is_fast_stop) {
            self.clone().serve(begun, peer, self.admit(peer), self.context.metrics.connected());
        }
        drop(slot);
    }

    fn admit(&self, peer: SocketAddr) -> Arc<ConnectionPermit> {
        Arc::new(self.admission.admit(peer.ip(), &self.closing))
    }

    async fn decrypted(&self, settings: Arc<HttpSettings>, stream: TcpStream, peer: SocketAddr) -> Option<Begun> {
        decrypt(&self.handshakes, &self.context.runtimes.requests, settings, stream, peer).await
    }

    /// Inspects a connection's first bytes and serves it on the matching runtime.
    async fn begin(
        self: Arc<Self>,
        stream: TcpStream,
        peer: SocketAddr,
        permit: Arc<ConnectionPermit>,
        connected: Connected,
    ) {
        let settings = self.context.settings.get();
        let idle_time = settings.web.idle_timeout;
        let begun = if settings.tls.is_none() {
            match inspect(stream, peer, &permit, idle_time).await {
                Inspected::Begun(begun) => Some(begun),
                Inspected::Evicted(stream) if !self.closing.is_cancelled() => {
                    drop(permit);
                    if let Some(slot) = self.admission.displaced().map(CrowdSlot::Undecided) {
                        self.inspect_in_crowd(stream, peer, slot);
                    }
                    return;
                }
                Inspected::Evicted(_) | Inspected::Ended => None,
            }
        } else {
            tokio::select! {
                biased;
                begun = self.decrypted(settings, stream, peer) => begun,
                () = permit.evicted() => None,
                () = sleep(idle_time) => None,
            }
        };
        if let Some(begun) = begun {
            // Only a whole FAST STOP keeps the rights of a connection that may still bring one.
            if !begun.is_whole {
                permit.begun();
            }
            self.serve(begun, peer, permit, connected);
        }
    }
}

#[cfg(test)]
mod tests;
