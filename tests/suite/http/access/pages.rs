//! Web pages: of the gateway itself, of other gateways on the same host, and of other origins.

use std::collections::BTreeMap;

use http::{HeaderValue, Method};
use serde_json::json;
use tokio_tungstenite::tungstenite::Error;

use super::guarded;
use crate::harness::{Directory, Gateway, Socket, socket_request};

/// Returns a ticket for the holder of this token, on a page of a listed origin.
async fn ticket(gateway: &Gateway, secret: &str) -> String {
    let request = reqwest::Client::new().post(gateway.url("/api/v1/tickets")).bearer_auth(secret);
    let issued = gateway.send(request.header("Origin", "https://hmi.example")).await.ok();
    assert_eq!(issued["expires_in_ms"], 30_000);
    issued["ticket"].as_str().unwrap().to_owned()
}

/// Opens a WebSocket of a page of a listed origin with these subprotocols. Returns the status of a refused handshake.
async fn socket_of_page(gateway: &Gateway, subprotocols: &str) -> Result<Socket, u16> {
    let mut request = socket_request(gateway);
    request.headers_mut().insert("origin", HeaderValue::from_static("https://hmi.example"));
    request.headers_mut().insert("sec-websocket-protocol", subprotocols.parse().unwrap());
    Socket::with(request).await.map_err(|error| match error {
        Error::Http(response) => response.status().as_u16(),
        error => panic!("{error}"),
    })
}

#[tokio::test]
async fn ticket_opens_one_socket_or_stream_of_a_page() {
    let files = Directory::new();
    let file = files.write("gateway.toml", "cors_origins = [\"https://hmi.example\"]\n");
    let tokens = ["--name boss --role supervisor", "--name robot --role operator", "--name curtain --role stop"];
    let (gateway, secrets) = Gateway::guarded(&tokens, &["--config", &file]).await;
    assert_eq!(socket_of_page(&gateway, "wsg.v1").await.err(), Some(401));
    let offered = format!("wsg.v1, wsg.ticket.{}", ticket(&gateway, &secrets[1]).await);
    let mut socket = socket_of_page(&gateway, &offered).await.unwrap();
    assert_eq!(socket.call("me", json!({})).await["name"], "robot");
    assert_eq!(socket_of_page(&gateway, &offered).await.err(), Some(401), "used");
    // The rights are those of the token, and end with it.
    gateway.revoke("robot").await;
    let refused = socket.refused("me", json!({})).await;
    assert_eq!(refused["data"]["code"], "unauthorized", "{refused}");

    let stream = async |ticket: &str| {
        let path = gateway.url(&format!("/api/v1/stream?topics=state&ticket={ticket}"));
        reqwest::Client::new().get(path).header("Origin", "https://hmi.example").send().await.unwrap()
    };
    let first = ticket(&gateway, &secrets[0]).await;
    let mut opened = stream(&first).await;
    assert_eq!(opened.headers()["x-accel-buffering"], "no");
    assert!(opened.chunk().await.unwrap().is_some());
    let again = stream(&first).await;
    assert_eq!(again.status(), 401);
    assert!(again.text().await.unwrap().contains("POST /api/v1/tickets"));
    let forbidden = ticket(&gateway, &secrets[2]).await;
    assert_eq!(stream(&forbidden).await.status(), 403, "the role stop reads nothing");

    let anonymous = reqwest::Client::new().post(gateway.url("/api/v1/tickets"));
    gateway.send(anonymous).await.problem(401, "unauthorized");
}

#[tokio::test]
async fn refused_socket_is_logged_with_its_remedy() {
    let gateway = Gateway::start(&["--gripper", "g=sim://wsg50"]).await;
    for _ in 0..3 {
        assert_eq!(socket_of_page(&gateway, "wsg.v1").await.err(), Some(403));
    }
    gateway.until_logged("WebSocket refused: ").await;
    let log = gateway.log();
    let lines: Vec<_> = log.lines().filter(|line| line.contains("WebSocket refused")).collect();
    assert_eq!(lines.len(), 1, "{lines:?}");
    for part in ["foreign_origin", "https://hmi.example", "cors_origins", "Host header"] {
        assert!(lines[0].contains(part), "{part}: {}", lines[0]);
    }
}

#[tokio::test]
async fn gateways_on_one_host_keep_the_sessions_of_one_browser_apart() {
    let (one, of_one) = guarded().await;
    let (other, of_other) = guarded().await;
    // A browser sends all cookies of a host to all its ports, and replaces those of the same name.
    let mut cookies = BTreeMap::new();
    for (gateway, secret) in [(&one, &of_one[1]), (&other, &of_other[1])] {
        let request = reqwest::Client::new().post(gateway.url("/api/v1/session")).json(&json!({"token": secret}));
        let cookie = request.send().await.unwrap().headers()["set-cookie"].to_str().unwrap().to_owned();
        let (name, value) = cookie.split(';').next().unwrap().split_once('=').unwrap();
        cookies.insert(name.to_owned(), value.to_owned());
    }
    let sent = cookies.iter().map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join("; ");
    for gateway in [&one, &other] {
        let me = reqwest::Client::new().get(gateway.url("/api/v1/me")).header("Cookie", &sent);
        assert_eq!(gateway.send(me).await.ok()["proof"], "session");
    }
}

#[tokio::test]
async fn page_of_a_listed_origin_can_use_the_api() {
    let toml = "cors_origins = [\"https://hmi.example\"]\n[grippers.g]\nurl = \"sim://wsg50\"\n";
    let gateway = Gateway::with_file(&[], toml).await;
    let client = reqwest::Client::new();
    let path = gateway.url("/api/v1/grippers/g/home");
    let preflight = |origin: &str| {
        let request = client.request(Method::OPTIONS, &path).header("Origin", origin);
        request
            .header("Access-Control-Request-Method", "POST")
            .header("Access-Control-Request-Headers", "authorization")
    };
    let allowed = preflight("https://hmi.example").send().await.unwrap();
    let headers = allowed.headers();
    assert_eq!(headers["access-control-allow-origin"], "https://hmi.example");
    assert!(headers["access-control-allow-headers"].to_str().unwrap().contains("authorization"));
    assert!(!headers.contains_key("access-control-allow-credentials"));
    let plain = client.request(Method::OPTIONS, &path).send().await.unwrap();
    assert_eq!(plain.status(), 405, "OPTIONS has no other use");
    let answer =
        client.get(gateway.url("/api/v1/grippers")).header("Origin", "https://hmi.example").send().await.unwrap();
    assert_eq!(answer.headers()["access-control-allow-origin"], "https://hmi.example");
    let exposed = answer.headers()["access-control-expose-headers"].to_str().unwrap();
    for name in ["etag", "next-cursor", "journal-id", "link", "location", "retry-after"] {
        assert!(exposed.split(',').any(|exposed| exposed == name), "{name}: {exposed}");
    }
    for foreign in ["https://evil.example", "http://hmi.example", "null"] {
        let refused = preflight(foreign).send().await.unwrap();
        assert_eq!((refused.status().as_u16(), refused.headers().get("access-control-allow-origin")), (403, None));
    }
}
