//! The handshake of a WebSocket (RFC 6455), which begins as an HTTP request.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::{Request, State as Shared};
use axum::http::header::{HeaderMap, HeaderValue, SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_PROTOCOL};
use axum::response::Response;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;
use hyper::upgrade::Upgraded;
use hyper_util::rt::TokioIo;
use tokio_tungstenite::tungstenite::handshake::server::create_response_with_body;

use super::stream::too_many;
use super::tickets::offered;
use crate::access::Visitor;
use crate::connections::admission::{Claim, Class, ConnectionPermit};
use crate::connections::client_stream::ClientStream;
use crate::interfaces::http::context::HttpContext;
use crate::interfaces::http::documents::paths::responses::SocketProblem;
use crate::interfaces::http::requests::visitor::Identified;
use crate::interfaces::websocket::{self, Connection, SUBPROTOCOL};
use crate::model::{Client, Door};
use crate::operations::Problem;

/// Length of a decoded `Sec-WebSocket-Key` (RFC 6455, 4.1).
const KEY_BYTES: usize = 16;

/// Open a WebSocket
///
/// The WebSocket speaks JSON-RPC 2.0 with the subprotocol `wsg.v1`: the operations of this API are its methods, and
/// updates are its notifications. `/api/v1/asyncapi.yaml` describes it. A web page of another origin also offers the
/// subprotocol `wsg.ticket.` followed by a ticket, which `get_ticket` returns.
#[utoipa::path(
    get, path = "/ws", operation_id = "websocket", tag = "journal",
    responses((status = 101, description = "The connection is now a WebSocket"), SocketProblem)
)]
pub async fn open(Shared(context): Shared<Arc<HttpContext>>, mut request: Request) -> Result<Response, Problem> {
    let identified = Identified::client_of(&context.gateway.access, request.extensions());
    // The rights are checked for each request.
    identified.identity.as_ref().map_err(|unknown| *unknown)?;
    let client = identified.client(Door::Ws);
    let visitor = identified.visitor;
    let mut response = create_response_with_body(&request, Body::empty).map_err(|error| {
        let detail = format!(
            "invalid WebSocket handshake: {error}; connect with the subprotocol {SUBPROTOCOL}, and let a proxy pass on \
             the headers Upgrade and Connection"
        );
        Problem::malformed("Upgrade", detail)
    })?;
    check_key(request.headers())?;
    if !offered(request.headers()).any(|name| name == SUBPROTOCOL) {
        let detail = format!("missing subprotocol: the client must offer {SUBPROTOCOL}");
        return Err(Problem::malformed("Sec-WebSocket-Protocol", detail));
    }
    response.headers_mut().insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(SUBPROTOCOL));
    let permit: Option<Arc<ConnectionPermit>> = request.extensions().get().cloned();
    let claim = permit.as_ref().map(|permit| permit.claim(Class::Streaming).ok_or_else(too_many)).transpose()?;
    let upgrade = hyper::upgrade::on(&mut request);
    tokio::spawn(async move {
        match upgrade.await {
            Ok(upgraded) => begin(upgraded, (client, visitor), (permit, claim), &context),
            Err(error) => tracing::debug!(%error, "WebSocket handshake not completed"),
        }
    });
    Ok(response)
}

/// Starts serving an upgraded connection on the sockets' runtimes.
fn begin(
    upgraded: Upgraded,
    client: (Client, Visitor),
    (permit, claim): (Option<Arc<ConnectionPermit>>, Option<Claim>),
    context: &Arc<HttpContext>,
) {
    let Ok(parts) = upgraded.downcast::<TokioIo<ClientStream>>() else {
        return tracing::error!("WebSocket upgrade failed: the connection is of another kind");
    };
    // A copy, so that hyper's buffer does not live as long as the socket.
    let early = Bytes::copy_from_slice(&parts.read_buf);
    let connection = Connection { stream: parts.io.into_inner(), early, permit, claim };
    let serving = context.of_interface(context.ws_metrics.clone());
    drop(context.runtimes.sockets.spawn(websocket::serve(connection, client, serving)));
}

fn check_key(headers: &HeaderMap) -> Result<(), Problem> {
    let keys: Vec<_> = headers.get_all(SEC_WEBSOCKET_KEY).iter().collect();
    let is_valid =
        matches!(&keys[..], [key] if STANDARD.decode(key.as_bytes()).is_ok_and(|key| key.len() == KEY_BYTES));
    if is_valid {
        return Ok(());
    }
    let detail = format!("Sec-WebSocket-Key must be {KEY_BYTES} random bytes in Base64 (RFC 6455, 4.1)");
    Err(Problem::malformed("Sec-WebSocket-Key", detail))
}
