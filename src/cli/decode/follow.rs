//! `wsg-gateway decode --follow URL`: prints the frames on a running gateway's device links as they pass.

use std::io::Write;
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use futures_util::{SinkExt as _, StreamExt as _};
use serde::Deserialize;
use serde_json::{Value, json};
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{Error, Message};
use url::Url;

use crate::model::FrameDirection;
use crate::transport::host::connect_to_host;

/// Time limit for connecting to any of the gateway's addresses.
const CONNECTED_WITHIN: Duration = Duration::from_secs(10);

/// A JSON-RPC message from a gateway.
#[derive(Debug, Deserialize)]
struct GatewayMessage {
    method: Option<String>,
    #[serde(default)]
    params: Value,
    error: Option<GatewayError>,
}

#[derive(Debug, Deserialize)]
struct GatewayError {
    message: String,
}

/// Printed fields of a `frame` or `damage` notification.
#[derive(Debug, Deserialize)]
struct WireEntry {
    gripper: String,
    at: String,
    direction: FrameDirection,
    text: String,
}

#[derive(Debug, Deserialize)]
struct Gap {
    gripper: String,
    missed: u64,
}

/// Writes one line per `frame` or `damage` notification, until the gateway ends or the output is closed.
///
/// # Errors
/// An unreachable gateway, or the end of the gateway or of the connection to it.
pub async fn follow(url: &Url, output: &mut impl Write) -> anyhow::Result<()> {
    let (address, gripper) = endpoint(url)?;
    let mut request =
        address.as_str().into_client_request().with_context(|| format!("{url} is not a valid address"))?;
    request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("wsg.v1"));
    let host = address.host_str().unwrap_or_default().trim_start_matches('[').trim_end_matches(']');
    let port = address.port_or_known_default().unwrap_or(80);
    let stream = connect_to_host(host, port, CONNECTED_WITHIN).await;
    let stream = stream.map_err(|error| anyhow::anyhow!("no gateway answers at {url}: {error}"))?;
    let connected = client_async(request, stream).await;
    let (mut socket, _) =
        connected.map_err(|error| anyhow::anyhow!("no gateway answers at {url}: {}", describe(error)))?;
    let params = match &gripper {
        Some(gripper) => json!({"topics": ["frames"], "grippers": [gripper]}),
        None => json!({"topics": ["frames"]}),
    };
    let subscribe = json!({"jsonrpc": "2.0", "id": 1, "method": "subscribe", "params": params});
    socket.send(Message::text(subscribe.to_string())).await?;
    while let Some(message) = socket.next().await {
        match message {
            Ok(Message::Text(text)) => {
                let line = line(serde_json::from_str(&text).context("the gateway sent an invalid message")?)?;
                if let Some(line) = line {
                    writeln!(output, "{line}")?;
                    output.flush()?;
                }
            }
            Ok(Message::Close(Some(frame))) => bail!("the gateway closed the connection: {}", frame.reason),
            Ok(_) => {}
            Err(error) => bail!("connection to the gateway lost: {error}"),
        }
    }
    bail!("the gateway closed the connection")
}

/// Returns the URL of the gateway's WebSocket, and the gripper that the path names, if any.
fn endpoint(url: &Url) -> anyhow::Result<(Url, Option<String>)> {
    let remedy = "give http://HOST:PORT, or http://HOST:PORT/api/v1/grippers/NAME for one gripper";
    ensure!(matches!(url.scheme(), "http" | "ws"), "cannot follow {url}: {remedy}");
    let mut address = url.clone();
    address.set_query(None);
    address.set_path("/api/v1/ws");
    ensure!(address.set_scheme("ws").is_ok() && address.host().is_some(), "cannot follow {url}: {remedy}");
    let gripper = url.path().strip_prefix("/api/v1/grippers/").and_then(|path| path.split('/').next());
    ensure!(gripper.is_some() || matches!(url.path(), "/" | "/api/v1/ws"), "{url} names no gripper: {remedy}");
    Ok((address, gripper.map(ToOwned::to_owned)))
}

/// Formats a message as a line of output; returns none for messages that are not printed.
fn line(message: GatewayMessage) -> anyhow::Result<Option<String>> {
    if let Some(GatewayError { message }) = message.error {
        bail!("the gateway refused the subscription: {message}");
    }
    Ok(match message.method.as_deref() {
        Some("frame" | "damage") => {
            let WireEntry { gripper, at, direction, text } = serde_json::from_value(message.params)?;
            let mark = match direction {
                FrameDirection::Sent => '>',
                FrameDirection::Received => '<',
            };
            Some(format!("{at} {gripper} {mark} {text}"))
        }
        Some("gap") => {
            let Gap { gripper, missed } = serde_json::from_value(message.params)?;
            Some(format!("# {gripper}: {missed} frames are missing here: they arrived faster than they were read"))
        }
        _ => None,
    })
}

/// Describes a failed connection, with the gateway's own words if it sent a problem.
fn describe(error: Error) -> String {
    match error {
        Error::Http(response) => {
            let detail = response.body().as_ref().and_then(|body| serde_json::from_slice::<Value>(body).ok());
            let detail = detail.as_ref().and_then(|problem| problem["detail"].as_str()).unwrap_or_default();
            format!("{} {detail}", response.status())
        }
        error => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damage_is_printed_like_a_frame() {
        let params = json!({"gripper": "left", "seq": 7, "at": "2026-11-21T09:00:00.25Z", "direction": "received",
            "damage": "skipped", "id": null, "name": null, "bytes": 3, "hex": "000102",
            "text": "(3 bytes outside any frame)"});
        let message = GatewayMessage { method: Some("damage".to_owned()), params, error: None };
        let expected = "2026-11-21T09:00:00.25Z left < (3 bytes outside any frame)";
        assert_eq!(line(message).unwrap().unwrap(), expected);
    }

    #[test]
    fn address_names_a_gateway_or_a_gripper() {
        let endpoint = |url: &str| endpoint(&url.parse().unwrap()).map(|(url, gripper)| (url.to_string(), gripper));
        let address = "ws://127.0.0.1:8080/api/v1/ws".to_owned();
        assert_eq!(endpoint("http://127.0.0.1:8080").unwrap(), (address.clone(), None));
        let one = endpoint("http://127.0.0.1:8080/api/v1/grippers/left").unwrap();
        assert_eq!(one, (address, Some("left".to_owned())));
        for wrong in ["https://127.0.0.1", "tcp://127.0.0.1:1000", "http://127.0.0.1/left"] {
            assert!(endpoint(wrong).unwrap_err().to_string().contains("http://HOST:PORT"), "{wrong}");
        }
    }
}
