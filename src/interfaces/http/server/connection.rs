//! A connection that hyper serves: its requests, its runtime and its end.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::header::{CONNECTION, STRICT_TRANSPORT_SECURITY};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Request, StatusCode, Version};
use axum::response::{IntoResponse as _, Response};
use futures_util::future::{BoxFuture, FutureExt as _, TryFutureExt as _};
use hyper::body::{Body as _, Incoming};
use hyper::server::conn::http1;
use hyper::service::Service;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::runtime::Handle;
use tokio::sync::watch;
use tokio::time::timeout;
use tokio_util::either::Either;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use super::super::context::HttpContext;
use super::super::http_settings::HttpSettings;
use super::super::requests::operation::Compact;
use super::super::requests::requested_operation::OperationPaths;
use super::super::requests::visitor::{Identified, accepted_cookie};
use super::super::resources::tickets;
use super::inspection::Begun;
use super::runtime_mover::RuntimeMover;
use crate::access::ClientOrigin;
use crate::connections::admission::{Admission, Bounds, ConnectionPermit};
use crate::connections::client_stream::ClientStream;
use crate::connections::handshakes::Handshakes;
use crate::connections::metrics::Connected;
use crate::connections::pace::RequestPace;
use crate::model::Urgency;

const KEEP_ALIVE: HeaderName = HeaderName::from_static("keep-alive");

/// Maximum size of all headers of a request. This API needs some hundred bytes; browsers add a few thousand.
const MAX_HEADER_BYTES: usize = 16 * 1024;

/// Bytes that hyper buffers for a connection in each direction, apart from the bodies.
const MAX_BUFFER_BYTES: usize = 32 * 1024;

/// Tells browsers to use only TLS for a year (RFC 6797). They ignore it where they do not trust the certificate.
const ONLY_TLS: HeaderValue = HeaderValue::from_static("max-age=31536000");

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ServerLimits {
    /// Maximum number of concurrent connections, by class.
    pub bounds: Bounds,
    /// Time that running requests get to finish after a shutdown began.
    pub shutdown_time: Duration,
}

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

/// State shared by all connections of a server.
pub(super) struct Server {
    pub(super) router: Router,
    pub(super) paths: OperationPaths,
    pub(super) context: Arc<HttpContext>,
    pub(super) admission: Arc<Admission>,
    pub(super) limits: ServerLimits,
    pub(super) handshakes: Handshakes,
    pub(super) closing: CancellationToken,
}

impl Server {
    /// Serves a connection on the matching runtime.
    pub(super) fn serve(
        self: Arc<Self>,
        begun: Begun,
        peer: SocketAddr,
        permit: Arc<ConnectionPermit>,
        connected: Connected,
    ) {
        let Begun { mut stream, certificate, is_fast_stop, is_whole } = begun;
        let runtimes = &self.context.runtimes;
        // An unfinished FAST STOP is carried out on the requests' runtime, so that a flood of them delays no whole one.
        let runtime = if is_whole { runtimes.accept.clone() } else { runtimes.requests.clone() };
        let (moves, home) = watch::channel(runtime.clone());
        let has_request = Arc::<AtomicBool>::default();
        let service = Requests {
            server: self.clone(),
            origin: ClientOrigin { certificate, ..peer.ip().into() },
            permit: permit.clone(),
            mover: RuntimeMover::new(moves),
            pace: Arc::default(),
            has_request: has_request.clone(),
            gone: match &mut stream {
                Either::Left(stream) => stream.gone(),
                Either::Right(stream) => stream.below().gone(),
            },
        };
        let http = http1::Builder::new()
            .timer(TokioTimer::new())
            // The router adds the date, except to compact responses.
            .auto_date_header(false)
            .header_read_timeout(self.context.settings.get().web.idle_timeout)
            .max_header_size(MAX_HEADER_BYTES)
            .max_buf_size(MAX_BUFFER_BYTES)
            .serve_connection(TokioIo::new(stream), service)
            .with_upgrades();
        let http = Box::pin(http);
        let connection = Connection {
            server: self,
            peer,
            permit,
            is_fast_stop,
            is_whole,
            has_request,
            http,
            home,
            _connected: connected,
        };
        drop(runtime.spawn(connection.run()));
    }
}

/// A connection served by hyper, on one runtime at a time.
struct Connection {
    server: Arc<Server>,
    peer: SocketAddr,
    permit: Arc<ConnectionPermit>,
    /// Whether the connection began with a FAST STOP.
    is_fast_stop: bool,
    /// Whether this FAST STOP had arrived as a whole.
    is_whole: bool,
    /// Whether the head of a request has arrived.
    has_request: Arc<AtomicBool>,
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
                () = self.permit.evicted() => {
                    let ended = self.leave().await;
                    // Closes the socket. A FAST STOP may still be in progress, but it needs no slot any more.
                    drop(self.http);
                    self.permit.closed();
                    ended
                }
                Ok(()) = self.home.changed() => {
                    let runtime = self.home.borrow_and_update().clone();
                    drop(runtime.spawn(self.run()));
                    return;
                }
            };
            if let Err(error) = ended {
                tracing::debug!(peer = %self.peer, %error, "connection ended");
            }
        };
        run.boxed()
    }

    /// Ends the connection: at once if it has no whole request, else after the response. A FAST STOP whose body is
    /// unfinished is carried out nevertheless.
    async fn leave(&mut self) -> hyper::Result<()> {
        let has_request = self.has_request.load(Ordering::Relaxed);
        let limit = if self.server.closing.is_cancelled() {
            self.server.limits.shutdown_time
        } else if self.is_whole || self.permit.has_whole_request() {
            self.permit.linger_for_answer()
        } else if self.is_fast_stop && !has_request {
            self.permit.linger_for_fast_stop()
        } else if !self.permit.is_unused() {
            self.permit.linger()
        } else {
            return Ok(());
        };
        if has_request || !self.is_fast_stop {
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
    mover: RuntimeMover,
    pace: Arc<RequestPace>,
    /// Whether the head of a request has arrived.
    has_request: Arc<AtomicBool>,
    /// Cancelled when the client has ended the connection, although bytes of a further request wait.
    gone: CancellationToken,
}

impl Service<Request<Incoming>> for Requests {
    type Response = Response;
    type Error = Infallible;
    type Future = BoxFuture<'static, Result<Response, Infallible>>;

    fn call(&self, mut request: Request<Incoming>) -> Self::Future {
        let asked = self.server.paths.mark(&mut request);
        // A connection that continues after its first FAST STOP is treated like all others.
        if self.has_request.swap(true, Ordering::Relaxed) || asked.urgency() != Urgency::FastStop {
            self.mover.leave(&self.server.context.runtimes.accept, &self.server.context.runtimes.requests);
        }
        if !request.body().is_end_stream() {
            self.permit.receiving();
        }
        let settings = self.server.context.settings.get();
        let access = &self.server.context.gateway.access;
        let origin = self.origin.clone();
        let identified = if let Some(ticket) = tickets::presented(&request) {
            Identified::with(access, access.take_ticket(&ticket), origin)
        } else {
            let cookie = accepted_cookie(request.headers(), &settings);
            Identified::of(access, request.headers(), origin, cookie.as_deref())
        };
        let extensions = request.extensions_mut();
        extensions.insert(identified);
        extensions.insert(self.permit.clone());
        extensions.insert(self.mover.clone());
        extensions.insert(self.pace.clone());
        let is_last = is_last(&request);
        let response = self.server.router.clone().oneshot(request.map(Body::new));
        let permit = self.permit.clone();
        let response =
            response.map_ok(move |response| with_headers(response, &settings, is_last || permit.is_evicted()));
        if asked.stops() {
            // Does not depend on its connection: hyper drops a request unpolled if the client has closed already.
            return tokio::spawn(response)
                .map(|answered| answered.unwrap_or_else(|_| Ok(StatusCode::INTERNAL_SERVER_ERROR.into_response())))
                .boxed();
        }
        let gone = self.gone.clone();
        let answered = async move {
            tokio::select! {
                biased;
                response = response => response,
                // Dropping the request ends its use of the lease. Nobody reads this response.
                () = gone.cancelled() => Ok(StatusCode::REQUEST_TIMEOUT.into_response()),
            }
        };
        answered.boxed()
    }
}

/// Whether a client wants its connection to end after this request (RFC 9112, 9.3).
fn is_last(request: &Request<Incoming>) -> bool {
    let is_old = request.version() == Version::HTTP_10 && !has_option(request.headers(), "keep-alive");
    is_old || has_option(request.headers(), "close")
}

/// Whether a message has this connection option (RFC 9110, 7.6.1).
fn has_option(headers: &HeaderMap, option: &str) -> bool {
    let values = headers.get_all(CONNECTION).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|given| given.trim().eq_ignore_ascii_case(option))
}

/// Adds the headers of a connection: how long it stays open while it is idle, unless it `ends`, and that browsers use
/// only TLS.
fn with_headers(mut response: Response, settings: &HttpSettings, ends: bool) -> Response {
    let is_switched = response.status() == StatusCode::SWITCHING_PROTOCOLS;
    if is_switched || response.extensions().get::<Compact>().is_some() {
        return response;
    }
    let headers = response.headers_mut();
    if !ends && !has_option(headers, "close") {
        headers.insert(KEEP_ALIVE, settings.keep_alive());
    }
    if settings.tls.is_some() {
        headers.insert(STRICT_TRANSPORT_SECURITY, ONLY_TLS);
    }
    response
}
