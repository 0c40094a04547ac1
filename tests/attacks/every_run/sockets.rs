//! As many well-behaved WebSockets as the gateway accepts, and a few requests with unfinished bodies.

use std::io;
use std::sync::Arc;

use futures_util::{SinkExt as _, StreamExt as _};
use tokio::net::TcpStream;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::http::HeaderValue;

use crate::attack::{self, MANY};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::gateway::{Gateway, Limits};

const SOCKETS: usize = 1008;
const HALF_SENT: usize = 20;
/// Subscribes to events and states, reads everything, and answers pings.
pub async fn healthy_socket(crowd: Arc<Crowd>, _: usize, stream: TcpStream) -> io::Result<()> {
    subscribed(crowd, stream, r#"{"topics": ["state", "events"], "max_hz": 2}"#).await
}

/// Opens a WebSocket with these `subscribe` parameters, and reads all messages.
pub async fn subscribed(crowd: Arc<Crowd>, stream: TcpStream, params: &str) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let url = format!("ws://{}/api/v1/ws", crowd.address);
    let mut request = url.into_client_request().map_err(io::Error::other)?;
    request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("wsg.v1"));
    let (mut socket, _) = client_async(request, stream).await.map_err(io::Error::other)?;
    let subscribe = format!(r#"{{"jsonrpc": "2.0", "id": 1, "method": "subscribe", "params": {params}}}"#);
    socket.send(Message::text(subscribe)).await.map_err(io::Error::other)?;
    let _inside = crowd.inside();
    while let Some(message) = socket.next().await {
        message.map_err(io::Error::other)?;
    }
    Ok(())
}

#[test]
fn healthy_sockets_and_half_sent_bodies_block_no_client() {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || {
        let sockets = Attacker::start("healthy_sockets", SOCKETS, gateway.address);
        (sockets, Attacker::start("half_sent_bodies", HALF_SENT, gateway.address))
    };
    attack::run("1008 WebSockets, 20 half-sent bodies", MANY, (&gateway, &g), begin, |_, _| {}).blocks_no_client();
}
