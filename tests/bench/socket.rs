//! A WebSocket of the gateway.

use tokio::net::{TcpSocket, TcpStream};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::{WebSocketStream, client_async};

use crate::program::Error;

pub type Socket = WebSocketStream<TcpStream>;

/// Connects a WebSocket, with a receive buffer of this size if one is given.
pub async fn connect(address: &str, buffer: Option<u32>) -> Result<Socket, Error> {
    let tcp = TcpSocket::new_v4()?;
    if let Some(bytes) = buffer {
        tcp.set_recv_buffer_size(bytes)?;
    }
    let tcp = tcp.connect(address.parse()?).await?;
    tcp.set_nodelay(true)?;
    let mut request = format!("ws://{address}/api/v1/ws").into_client_request()?;
    request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("wsg.v1"));
    Ok(client_async(request, tcp).await?.0)
}
