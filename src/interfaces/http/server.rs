//! The accept loop, and the life of a connection: its first bytes, its requests, its end.
//!
//! `axum::serve` bounds neither connections nor the time for a request's header, so this builds on hyper. [`Admission`]
//! admits connections. The server inspects the first bytes of each. A connection that begins with a FAST STOP is served
//! on the accepting runtime, which does nothing else; all others move to
//! [`Runtimes::requests`](crate::interfaces::Runtimes::requests). A connection that streams updates moves to
//! [`Runtimes::observers`](crate::interfaces::Runtimes::observers).

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::header::{ORIGIN, STRICT_TRANSPORT_SECURITY};
use axum::http::{HeaderName, HeaderValue, Request, StatusCode};
use axum::response::Response;
use bytes::BytesMut;
use futures_util::future::{BoxFuture, FutureExt as _, TryFutureExt as _};
use hyper::body::{Body as _, Incoming};
use hyper::server::conn::http1;
use hyper::service::Service;
use hyper_util::rt::{TokioIo, TokioTimer};
use rustix::net::RecvFlags;
use socket2::SockRef;
use tokio::io::AsyncReadExt as _;
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio::time::{Instant, sleep, timeout};
use tokio_rustls::LazyConfigAcceptor;
use tokio_rustls::rustls::server::Acceptor;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;
use tower::ServiceExt;

use super::context::HttpContext;
use super::fast_stop::{is_fast_stop, may_be_fast_stop};
use super::handshakes::Handshakes;
use super::home::Home;
use super::operation::Compact;
use super::redirect;
use super::router::router;
use super::settings::HttpSettings;
use super::visitor::{Identified, cookie_name};
use crate::access::{ClientCertificate, ClientOrigin};
use crate::interfaces::admission::{Admission, Bounds, ConnectionPermit, Usage};
use crate::interfaces::client_stream::{ClientStream, EncryptedStream};
use crate::interfaces::metrics::Connected;
use crate::interfaces::pace::RequestPace;
use crate::interfaces::quick_ack::QuickAckStream;
use crate::interfaces::sockets;
use crate::interfaces::tls::holder;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ServerLimits {
    /// Maximum number of concurrent connections, by class.
    pub bounds: Bounds,
    /// Time that running requests get to finish after a shutdown began.
    pub shutdown_time: Duration,
}

const KEEP_ALIVE: HeaderName = HeaderName::from_static("keep-alive");

/// Maximum size of all headers of a request. This API needs some hundred bytes; browsers add a few thousand.
const MAX_HEADER_BYTES: usize = 16 * 1024;

/// Bytes that hyper buffers for a connection in each direction, apart from the bodies.
const MAX_BUFFER_BYTES: usize = 32 * 1024;

/// Unsent bytes that the kernel queues for a slow client: some dozens of updates.
#[cfg(target_os = "linux")]
const MAX_UNSENT_BYTES: u32 = 16 * 1024;

/// Connections that the kernel queues until they are accepted. A FAST STOP waits in this queue during a flood of
/// connects, so a larger backlog delays it longer.
const BACKLOG: u32 = 2048;

/// Pause after a failed accept: long enough not to spin while the process is out of file descriptors, short enough not
/// to be noticed.
const ACCEPT_PAUSE: Duration = Duration::from_millis(5);

/// Extra time that the server waits for its connections beyond their own shutdown time.
const SHUTDOWN_SLACK: Duration = Duration::from_millis(100);

/// Bytes of a request that are searched for a FAST STOP, whose longest path has 111 bytes.
const FIRST_BYTES: usize = 256;

/// Time that accepting waits for evicted connections to end.
const ROOM_WITHIN: Duration = Duration::from_millis(10);

/// Pause after a wait for evicted connections that freed nothing.
const STALLED_FOR: Duration = Duration::from_millis(200);

/// Time for the rest of a first line to arrive after its beginning.
const FIRST_LINE_WITHIN: Duration = Duration::from_millis(20);

/// Time for a TLS handshake and the first line behind it while too many connections are leaving.
const HANDSHAKE_IN_CROWD: Duration = Duration::from_millis(500);

/// Time after which a handshake's turn ends although it continues: a client that has gone silent needs no processor.
const HANDSHAKE_TURN: Duration = Duration::from_millis(5);

/// First byte of a connection that speaks TLS (RFC 8446, 5.1).
const TLS_HANDSHAKE: u8 = 22;

/// Tells browsers to use only TLS for a year (RFC 6797). They ignore it where they do not trust the certificate.
const ONLY_TLS: HeaderValue = HeaderValue::from_static("max-age=31536000");

impl ServerLimits {
    /// Returns the default times with these bounds.
    #[must_use]
    pub fn within(bounds: Bounds) -> Self {
        // The grippers get 2 s to end their motions, and the responses must still be sent after that.
        Self { bounds, shutdown_time: Duration::from_secs(3) }
    }
}

impl Default for ServerLimits {
    fn default() -> Self {
        Self::within(Bounds::of(Bounds::MAX_DESCRIPTORS))
    }
}

/// Returns a listener on this address, on the caller's runtime.
pub fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    // A restarted gateway must not wait for the connections of its last run to time out.
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

/// The listener, which a reload can replace.
pub type Listeners = watch::Receiver<Arc<TcpListener>>;

/// Serves until `shutdown`, then finishes the running requests.
pub async fn serve(listeners: Listeners, context: Arc<HttpContext>, limits: ServerLimits, shutdown: CancellationToken) {
    let admission = Admission::new(limits.bounds);
    if let Err(error) = Usage::register(&context.registry, "http", &admission) {
        tracing::warn!(%error, "connection metrics unavailable");
    }
    let (router, closing, handshakes) = (router(&context), shutdown.child_token(), Handshakes::default());
    let server = Arc::new(Server { router, context, admission, limits, handshakes, closing });
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

struct Server {
    router: Router,
    context: Arc<HttpContext>,
    admission: Arc<Admission>,
    limits: ServerLimits,
    handshakes: Handshakes,
    closing: CancellationToken,
}

impl Server {
    async fn accept_all(self: &Arc<Self>, mut listeners: Listeners) {
        let mut stalled_at: Option<Instant> = None;
        let mut listener = listeners.borrow_and_update().clone();
        loop {
            // Evicted connections usually end at once.
            if self.admission.is_crowded() && stalled_at.is_none_or(|at| at.elapsed() > STALLED_FOR) {
                let has_room = timeout(ROOM_WITHIN, self.admission.has_room()).await.is_ok();
                stalled_at = (!has_room).then(Instant::now);
            }
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
                    if let Some(place) = self.reserved_for(&stream) {
                        tokio::spawn(self.clone().admit_fast_stop(stream, peer, place));
                    }
                }
                Ok((stream, peer)) => {
                    let permit = Arc::new(self.admission.admit(peer.ip(), &self.closing));
                    let connected = self.context.metrics.connected();
                    tokio::spawn(self.clone().begin(stream, peer, permit, connected));
                }
                Err(error) => {
                    tracing::warn!(%error, "connection could not be accepted");
                    self.admission.evict_one();
                    sleep(ACCEPT_PAUSE).await;
                }
            }
        }
    }

    /// Returns a slot for inspecting a connection when all others are taken. A connection whose first line is already a
    /// FAST STOP can use slots that others can't.
    fn reserved_for(&self, stream: &TcpStream) -> Option<OwnedSemaphorePermit> {
        let mut first = [0; FIRST_BYTES];
        let seen = peek_now(stream, &mut first);
        let first = first.get(..seen)?;
        self.admission.reserved(first.contains(&b'\n') && may_be_fast_stop(first))
    }

    /// Admits a connection only if it begins with a FAST STOP.
    async fn admit_fast_stop(self: Arc<Self>, stream: TcpStream, peer: SocketAddr, place: OwnedSemaphorePermit) {
        let admit = || Arc::new(self.admission.admit(peer.ip(), &self.closing));
        let settings = self.context.settings.get();
        if settings.tls.is_some() {
            let begun = timeout(HANDSHAKE_IN_CROWD, self.decrypted(settings, stream, peer)).await;
            if let Some(begun) = begun.ok().flatten().filter(|begun| begun.is_fast_stop) {
                self.clone().serve(begun, peer, admit(), self.context.metrics.connected());
            }
        } else {
            let mut first = [0; FIRST_BYTES];
            let seen = timeout(FIRST_LINE_WITHIN, stream.peek(&mut first)).await.map_or(0, Result::unwrap_or_default);
            if may_be_fast_stop(first.get(..seen).unwrap_or_default()) {
                self.clone().begin(stream, peer, admit(), self.context.metrics.connected()).await;
            }
        }
        drop(place);
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
        let idle_time = settings.idle_time;
        let begun = if settings.tls.is_none() {
            self.inspected(stream, peer, &permit, idle_time).await
        } else {
            tokio::select! {
                biased;
                begun = self.decrypted(settings, stream, peer) => begun,
                () = permit.evicted() => None,
                () = sleep(idle_time) => None,
            }
        };
        if let Some(begun) = begun {
            self.serve(begun, peer, permit, connected);
        }
    }

    /// Inspects the first bytes of a connection, which stay to be read.
    async fn inspected(
        &self,
        stream: TcpStream,
        peer: SocketAddr,
        permit: &ConnectionPermit,
        idle_time: Duration,
    ) -> Option<Begun> {
        let mut first = [0; FIRST_BYTES];
        let mut seen = tokio::select! {
            biased;
            seen = stream.peek(&mut first) => seen.unwrap_or(0),
            // Bytes that arrived before the eviction still count.
            () = permit.evicted() => peek_now(&stream, &mut first),
            () = sleep(idle_time) => 0,
        };
        if seen == 0 {
            return None;
        }
        if !first.contains(&b'\n') && seen < FIRST_BYTES {
            // The first line can arrive in two packets.
            sleep(FIRST_LINE_WITHIN).await;
            seen = peek_now(&stream, &mut first);
        }
        // A connection that sends nothing never gets here and costs no call.
        prepare(&stream, peer)?;
        let is_fast_stop = may_be_fast_stop(first.get(..seen).unwrap_or_default());
        Some(Begun { stream: ClientStream::Left(QuickAckStream::new(stream)), certificate: None, is_fast_stop })
    }

    /// Performs a TLS handshake, and reads the first line behind it. A client that does not speak TLS is redirected.
    async fn decrypted(&self, settings: Arc<HttpSettings>, stream: TcpStream, peer: SocketAddr) -> Option<Begun> {
        prepare(&stream, peer)?;
        let mut kind = [0];
        if stream.peek(&mut kind).await.ok()? == 0 {
            return None;
        }
        if kind != [TLS_HANDSHAKE] {
            let answered = redirect::answer(stream, settings);
            let _ = AbortOnDropHandle::new(self.context.runtimes.requests.spawn(answered)).await;
            return None;
        }
        // The first message of a client costs little, so a client that sends none takes no turn.
        let hello = LazyConfigAcceptor::new(Acceptor::default(), QuickAckStream::new(stream)).await;
        let hello = hello.inspect_err(|error| tracing::debug!(%peer, %error, "no TLS connection")).ok()?;
        let turn = self.handshakes.turn(peer.ip()).await;
        let tls = settings.tls.as_ref()?.config();
        let handshake = async move {
            let mut stream = hello.into_stream(tls).await?;
            let mut first = BytesMut::with_capacity(FIRST_BYTES);
            while !first.contains(&b'\n') && first.len() < FIRST_BYTES {
                if stream.read_buf(&mut first).await? == 0 {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
            }
            io::Result::Ok((first.freeze(), stream))
        };
        // A handshake takes as much processor time as many requests, and a FAST STOP must not wait for it.
        let mut handshake = AbortOnDropHandle::new(self.context.runtimes.requests.spawn(handshake));
        let in_turn = timeout(HANDSHAKE_TURN, &mut handshake).await;
        drop(turn);
        let handshake = match in_turn {
            Ok(handshake) => handshake,
            Err(_) => handshake.await,
        };
        let (first, stream) =
            handshake.ok()?.inspect_err(|error| tracing::debug!(%peer, %error, "no TLS connection")).ok()?;
        let certificate = stream.get_ref().1.peer_certificates().and_then(|chain| holder(chain.first()?));
        let is_fast_stop = may_be_fast_stop(&first);
        let stream = ClientStream::Right(Box::new(EncryptedStream::new(first, stream)));
        Some(Begun { stream, certificate, is_fast_stop })
    }

    /// Serves a connection on the matching runtime.
    fn serve(self: Arc<Self>, begun: Begun, peer: SocketAddr, permit: Arc<ConnectionPermit>, connected: Connected) {
        let Begun { stream, certificate, is_fast_stop } = begun;
        let runtimes = &self.context.runtimes;
        let runtime = if is_fast_stop { runtimes.accept.clone() } else { runtimes.requests.clone() };
        let (moves, home) = watch::channel(runtime.clone());
        let service = Requests {
            server: self.clone(),
            origin: ClientOrigin { certificate, ..peer.ip().into() },
            permit: permit.clone(),
            home: Home::new(moves),
            pace: Arc::default(),
            has_served: Arc::default(),
        };
        let http = http1::Builder::new()
            .timer(TokioTimer::new())
            // The router adds the date, except to compact responses.
            .auto_date_header(false)
            .header_read_timeout(self.context.settings.get().idle_time)
            .max_header_size(MAX_HEADER_BYTES)
            .max_buf_size(MAX_BUFFER_BYTES)
            .serve_connection(TokioIo::new(stream), service)
            .with_upgrades();
        let http = Box::pin(http);
        let connection = Connection { server: self, peer, permit, is_fast_stop, http, home, _connected: connected };
        drop(runtime.spawn(connection.run()));
    }
}

/// A connection whose first line has been inspected.
struct Begun {
    stream: ClientStream,
    certificate: Option<ClientCertificate>,
    /// Whether the connection begins with a FAST STOP.
    is_fast_stop: bool,
}

/// A connection served by hyper, on one runtime at a time.
struct Connection {
    server: Arc<Server>,
    peer: SocketAddr,
    permit: Arc<ConnectionPermit>,
    /// Whether the connection began with a FAST STOP.
    is_fast_stop: bool,
    http: Pin<Box<http1::UpgradeableConnection<TokioIo<ClientStream>, Requests>>>,
    home: watch::Receiver<Handle>,
    _connected: Connected,
}

impl Connection {
    /// Serves the connection until it ends or moves to another runtime.
    fn run(mut self) -> BoxFuture<'static, ()> {
        let run = async move {
            let ended = tokio::select! {
                biased;
                ended = self.http.as_mut() => ended,
                () = self.permit.evicted() => self.leave().await,
                Ok(()) = self.home.changed() => {
                    let home = self.home.borrow_and_update().clone();
                    drop(home.spawn(self.run()));
                    return;
                }
            };
            if let Err(error) = ended {
                tracing::debug!(peer = %self.peer, %error, "connection ended");
            }
        };
        run.boxed()
    }

    /// Ends the connection: at once if it has no request, else after the response.
    async fn leave(&mut self) -> hyper::Result<()> {
        let limit = if self.server.closing.is_cancelled() {
            self.server.limits.shutdown_time
        } else if self.is_fast_stop || !self.permit.is_unused() {
            self.permit.linger()
        } else {
            return Ok(());
        };
        if !self.permit.is_unused() || !self.is_fast_stop {
            self.http.as_mut().graceful_shutdown();
        }
        timeout(limit, self.http.as_mut()).await.unwrap_or(Ok(()))
    }
}

#[derive(Clone)]
struct Requests {
    server: Arc<Server>,
    origin: ClientOrigin,
    permit: Arc<ConnectionPermit>,
    home: Home,
    pace: Arc<RequestPace>,
    /// Whether a request has arrived.
    has_served: Arc<AtomicBool>,
}

impl Service<Request<Incoming>> for Requests {
    type Response = Response;
    type Error = Infallible;
    type Future = BoxFuture<'static, Result<Response, Infallible>>;

    fn call(&self, mut request: Request<Incoming>) -> Self::Future {
        // A connection that continues after its first FAST STOP is treated like all others.
        if self.has_served.swap(true, Ordering::Relaxed) || !is_fast_stop(&request) {
            self.home.leave(&self.server.context.runtimes.accept, &self.server.context.runtimes.requests);
        }
        if !request.body().is_end_stream() {
            self.permit.receiving();
        }
        let (settings, access) = (self.server.context.settings.get(), &self.server.context.gateway.access);
        // Pages of other origins have no session here.
        let is_foreign = request.headers().get_all(ORIGIN).iter().any(|origin| settings.allows_origin(origin));
        let cookie = (!is_foreign).then(|| cookie_name(settings.tls.is_some()));
        let identified = Identified::of(access, request.headers(), self.origin.clone(), cookie);
        let extensions = request.extensions_mut();
        extensions.insert(identified);
        extensions.insert(self.permit.clone());
        extensions.insert(self.home.clone());
        extensions.insert(self.pace.clone());
        let response = self.server.router.clone().oneshot(request.map(Body::new));
        response.map_ok(move |response| with_headers(response, &settings)).boxed()
    }
}

/// Tells the client how long an idle connection stays open, and browsers to use only TLS.
fn with_headers(mut response: Response, settings: &HttpSettings) -> Response {
    let is_switched = response.status() == StatusCode::SWITCHING_PROTOCOLS;
    if !is_switched && response.extensions().get::<Compact>().is_none() {
        response.headers_mut().insert(KEEP_ALIVE, settings.keep_alive());
        if settings.tls.is_some() {
            response.headers_mut().insert(STRICT_TRANSPORT_SECURITY, ONLY_TLS);
        }
    }
    response
}

/// Sets a connection's options. Responses are small and awaited. An open request keeps a lease, so a vanished client
/// must be noticed.
fn prepare(stream: &TcpStream, peer: SocketAddr) -> Option<()> {
    if let Err(error) = sockets::prepare(stream) {
        tracing::debug!(%peer, %error, "connection refused: socket options could not be set");
        return None;
    }
    set_unsent_limit(stream);
    Some(())
}

/// Peeks without waiting for tokio's readiness, which a fresh stream does not have yet.
fn peek_now(stream: &TcpStream, buffer: &mut [u8]) -> usize {
    rustix::net::recv(stream, buffer, RecvFlags::PEEK | RecvFlags::DONTWAIT).map_or(0, |(_, bytes)| bytes)
}

/// Limits the unsent bytes in the kernel, which would be stale before the client reads them and defeat newest-wins.
fn set_unsent_limit(stream: &TcpStream) {
    #[cfg(target_os = "linux")]
    if let Err(error) = SockRef::from(stream).set_tcp_notsent_lowat(MAX_UNSENT_BYTES) {
        tracing::debug!(%error, "TCP_NOTSENT_LOWAT could not be set");
    }
}

#[cfg(test)]
#[path = "server_tests.rs"]
mod tests;
