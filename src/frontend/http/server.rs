//! The accept loop. It bounds what a client can take: connections, and the time that a request's header may need,
//! which `axum::serve` leaves open.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::ConnectInfo;
use axum::http::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use super::prompt::Prompt;
use super::{Context, router};
use crate::frontend::connections::{Connections, Guest};
use crate::frontend::sockets;

/// Bounds of the server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Connections at a time. From [`RESERVED_CONNECTIONS`] below it, the one that has been idle the longest makes
    /// room for a new one.
    pub connections: usize,
    /// How long a request's header may take, and how long a connection may be idle: until the next request's header
    /// is there.
    pub header_time: Duration,
    /// How long requests may go on after a shutdown was asked for.
    pub shutdown_time: Duration,
}

/// Connections that are kept free by closing idle ones, so that a FAST STOP finds a place.
pub const RESERVED_CONNECTIONS: usize = 16;

/// Headers of a request, in all. The longest that this API means is some hundred bytes; browsers add a few thousand.
const MAX_HEADER_BYTES: usize = 16 * 1024;

/// What may wait in the kernel for a client that takes no more: some dozens of updates.
#[cfg(target_os = "linux")]
const MAX_UNSENT_BYTES: u32 = 16 * 1024;

/// How long no connection is accepted after that failed: long enough not to spin while the process is out of file
/// descriptors, short enough not to be noticed.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

impl Default for Limits {
    fn default() -> Self {
        Self {
            // A thousand observers, and some room: half of the 2048 file descriptors that a service may be limited to.
            connections: 1024,
            header_time: Duration::from_secs(10),
            // The grippers get 2 s to end their motions, whose answers have to go out.
            shutdown_time: Duration::from_secs(3),
        }
    }
}

/// Serves until `shutdown`, and then what is being answered already.
pub async fn serve(listener: TcpListener, context: Arc<Context>, limits: Limits, shutdown: CancellationToken) {
    let metrics = context.metrics.clone();
    let router = router(&context);
    let closing = shutdown.child_token();
    let connections = Arc::new(Connections::new(limits.connections, RESERVED_CONNECTIONS));
    let mut tasks = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            biased;
            () = shutdown.cancelled() => break,
            Some(_) = tasks.join_next() => continue,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, peer)) => {
                if let Some(guest) = connections.admit(&closing) {
                    let (router, connected) = (router.clone(), metrics.connected());
                    tasks.spawn(async move {
                        connection(stream, peer, router, guest, limits).await;
                        drop(connected);
                    });
                } else {
                    tracing::warn!(%peer, limit = limits.connections, "connection refused: too many are open");
                }
            }
            Err(error) => {
                tracing::warn!(%error, "no connection could be accepted");
                sleep(ACCEPT_PAUSE).await;
            }
        }
    }
    drop(listener);
    let ended = async {
        while tasks.join_next().await.is_some() {}
        // A WebSocket has left its connection's task.
        connections.all_ended().await;
    };
    if timeout(limits.shutdown_time, ended).await.is_err() {
        tracing::warn!(open = tasks.len(), "connections are closed before their requests were answered");
        tasks.shutdown().await;
    }
}

async fn connection(stream: TcpStream, peer: SocketAddr, router: Router, guest: Guest, limits: Limits) {
    // Answers are small, and awaited; and an open request keeps a lease, so that whose machine vanishes must be noticed.
    if let Err(error) = sockets::prepare(&stream) {
        return tracing::debug!(%peer, %error, "connection refused: its options could not be set");
    }
    set_unsent_limit(&stream);
    let guest = Arc::new(guest);
    let busy = guest.clone();
    let service = service_fn(move |mut request: Request<Incoming>| {
        request.extensions_mut().insert(ConnectInfo(peer));
        request.extensions_mut().insert(busy.clone());
        let answered = router.clone().oneshot(request.map(Body::new));
        let busy = busy.busy();
        async move {
            let answer: Result<_, Infallible> = answered.await;
            drop(busy);
            answer
        }
    });
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.header_time)
        .max_header_size(MAX_HEADER_BYTES)
        .serve_connection(TokioIo::new(Prompt::new(stream)), service)
        .with_upgrades();
    let mut served = std::pin::pin!(served);
    let ended = tokio::select! {
        ended = served.as_mut() => ended,
        () = guest.asked_to_leave() => {
            if guest.is_unused() {
                return;
            }
            // An idle one ends at once, and one that doesn't read its answer not much later.
            served.as_mut().graceful_shutdown();
            timeout(limits.shutdown_time, served).await.unwrap_or(Ok(()))
        }
    };
    if let Err(error) = ended {
        tracing::debug!(%peer, %error, "connection ended");
    }
}

/// What the kernel takes beyond what the client takes is old before it is read: newest-wins ends there.
fn set_unsent_limit(stream: &TcpStream) {
    #[cfg(target_os = "linux")]
    if let Err(error) = socket2::SockRef::from(stream).set_tcp_notsent_lowat(MAX_UNSENT_BYTES) {
        tracing::debug!(%error, "TCP_NOTSENT_LOWAT could not be set");
    }
}

#[cfg(test)]
#[path = "server_tests.rs"]
mod tests;
