//! `wsg-gateway decode --follow URL`: the frames on a running gateway's wires, as they go.

use std::io::Write;

use anyhow::{Context as _, bail, ensure};
use futures_util::{SinkExt as _, StreamExt as _};
use serde::Deserialize;
use serde_json::{Value, json};
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{Error, Message};
use url::Url;

use crate::gripper::model::{Frame, FrameDirection};

/// What a gateway says.
#[derive(Debug, Deserialize)]
struct Said {
    method: Option<String>,
    #[serde(default)]
    params: Value,
    error: Option<Refused>,
}

#[derive(Debug, Deserialize)]
struct Refused {
    message: String,
}

#[derive(Debug, Deserialize)]
struct Gap {
    gripper: String,
    missed: u64,
}

/// Writes a line a frame, until the gateway ends or nobody reads the lines any more.
///
/// # Errors
/// Where there is no gateway, or it has ended.
pub async fn follow(url: &Url, output: &mut impl Write) -> anyhow::Result<()> {
    let (address, gripper) = place(url)?;
    let mut request = address.as_str().into_client_request().with_context(|| format!("{url} is no address"))?;
    request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("wsg.v1"));
    let connected = connect_async(request).await;
    let (mut socket, _) =
        connected.map_err(|error| anyhow::anyhow!("no gateway answers at {url}: {}", words(error)))?;
    let params = match &gripper {
        Some(gripper) => json!({"topics": ["frames"], "grippers": [gripper]}),
        None => json!({"topics": ["frames"]}),
    };
    let subscribe = json!({"jsonrpc": "2.0", "id": 1, "method": "subscribe", "params": params});
    socket.send(Message::text(subscribe.to_string())).await?;
    while let Some(message) = socket.next().await {
        match message {
            Ok(Message::Text(text)) => {
                let line = line(serde_json::from_str(&text).context("the gateway's words are not understood")?)?;
                if let Some(line) = line {
                    writeln!(output, "{line}")?;
                    output.flush()?;
                }
            }
            Ok(Message::Close(Some(frame))) => bail!("the gateway has ended it: {}", frame.reason),
            Ok(_) => {}
            Err(error) => bail!("the connection to the gateway was lost: {error}"),
        }
    }
    bail!("the gateway has ended it")
}

/// Where its WebSocket is, and which gripper is meant where the address is one's.
fn place(url: &Url) -> anyhow::Result<(Url, Option<String>)> {
    let remedy = "give http://HOST:PORT, or http://HOST:PORT/api/v1/grippers/NAME for one gripper";
    ensure!(matches!(url.scheme(), "http" | "ws"), "{url} is no address to follow: {remedy}");
    let mut place = url.clone();
    place.set_query(None);
    place.set_path("/api/v1/ws");
    ensure!(place.set_scheme("ws").is_ok() && place.host().is_some(), "{url} is no address to follow: {remedy}");
    let gripper = url.path().strip_prefix("/api/v1/grippers/").and_then(|path| path.split('/').next());
    ensure!(gripper.is_some() || matches!(url.path(), "/" | "/api/v1/ws"), "{url} names no gripper: {remedy}");
    Ok((place, gripper.map(ToOwned::to_owned)))
}

/// What is written of what was said.
fn line(said: Said) -> anyhow::Result<Option<String>> {
    if let Some(Refused { message }) = said.error {
        bail!("the gateway refuses: {message}");
    }
    Ok(match said.method.as_deref() {
        Some("frame") => {
            let Frame { gripper, at, direction, text, .. } = serde_json::from_value(said.params)?;
            let mark = match direction {
                FrameDirection::Sent => '>',
                FrameDirection::Received => '<',
            };
            Some(format!("{at} {gripper} {mark} {text}"))
        }
        Some("gap") => {
            let Gap { gripper, missed } = serde_json::from_value(said.params)?;
            Some(format!("# {gripper}: {missed} frames came faster than they were read, and are missing here"))
        }
        _ => None,
    })
}

/// What a gateway that refuses says of it.
fn words(error: Error) -> String {
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
    fn an_address_is_a_gateways_or_a_grippers() {
        let place = |url: &str| place(&url.parse().unwrap()).map(|(url, gripper)| (url.to_string(), gripper));
        let address = "ws://127.0.0.1:8080/api/v1/ws".to_owned();
        assert_eq!(place("http://127.0.0.1:8080").unwrap(), (address.clone(), None));
        let one = place("http://127.0.0.1:8080/api/v1/grippers/left").unwrap();
        assert_eq!(one, (address, Some("left".to_owned())));
        for wrong in ["https://127.0.0.1", "tcp://127.0.0.1:1000", "http://127.0.0.1/left"] {
            assert!(place(wrong).unwrap_err().to_string().contains("http://HOST:PORT"), "{wrong}");
        }
    }
}
