//! WebSocket: JSON-RPC 2.0, with the methods of the HTTP API, and updates as notifications.

mod bodies;
mod outgoing;
mod rpc;
mod socket;

use std::sync::Arc;

use axum::Extension;
use axum::extract::State as Shared;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::http::{Extensions, HeaderValue};
use axum::response::Response;

use super::Context;
use super::body::MAX_BODY_BYTES;
use super::errors::{Code, Problem};
use super::extract::Asker;
use super::methods::Methods;
use super::responses::SocketProblem;
use crate::frontend::connections::Guest;
use crate::gripper::model::Door;
use socket::Socket;

pub use bodies::{Subscribe, Subscribed};

/// What is spoken.
pub const SUBPROTOCOL: &str = "wsg.v1";

/// What is read at once: requests are small, and there may be a thousand clients.
const READ_BYTES: usize = 4 * 1024;

/// What is gathered before it is written, and what may wait to be written: the longest answer, and some updates.
const WRITE_BYTES: usize = 16 * 1024;
const MAX_UNWRITTEN_BYTES: usize = 256 * 1024;

/// WebSocket
///
/// JSON-RPC 2.0 by the subprotocol `wsg.v1`: the operations of this API as methods, and updates as notifications.
/// `/api/v1/asyncapi.yaml` describes it.
#[utoipa::path(
    get, path = "/ws", operation_id = "websocket", tag = "journal",
    responses((status = 101, description = "From here on it is a WebSocket"), SocketProblem)
)]
pub async fn open(
    Shared(context): Shared<Arc<Context>>,
    Extension(methods): Extension<Methods>,
    extensions: Extensions,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, Problem> {
    let mut upgrade = upgrade.map_err(|rejection| {
        let detail = format!("{}: connect by WebSocket, with the subprotocol {SUBPROTOCOL}", rejection.body_text());
        Problem::malformed("Upgrade", detail)
    })?;
    if !upgrade.requested_protocols().any(|offered| offered == SUBPROTOCOL) {
        let detail = format!("offer the subprotocol {SUBPROTOCOL}: this is what is spoken here");
        return Err(Problem::malformed("Sec-WebSocket-Protocol", detail));
    }
    upgrade.set_selected_protocol(HeaderValue::from_static(SUBPROTOCOL));
    let guest: Option<Arc<Guest>> = extensions.get().cloned();
    if guest.as_ref().is_some_and(|guest| !guest.stay()) {
        return Err(Problem::new(Code::Overloaded, "as many WebSockets are open as are allowed: close some first"));
    }
    let client = Asker::through(Door::Ws, "ws", &extensions).0;
    let upgrade = upgrade
        .max_message_size(MAX_BODY_BYTES)
        .max_frame_size(MAX_BODY_BYTES)
        .read_buffer_size(READ_BYTES)
        .write_buffer_size(WRITE_BYTES)
        .max_write_buffer_size(MAX_UNWRITTEN_BYTES);
    Ok(upgrade.on_upgrade(async move |socket| {
        let sockets = context.sockets.clone();
        let served = sockets.spawn(async move {
            Socket::new(socket, client, methods, &context).run().await;
            // Its place is free only now.
            drop(guest);
        });
        if let Err(error) = served.await {
            tracing::error!(%error, "a WebSocket has panicked");
        }
    }))
}
