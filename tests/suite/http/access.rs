//! Roles, credentials and TLS, against a running gateway.

mod expiry;
mod pages;
mod tls;

use std::collections::BTreeMap;

use futures_util::{SinkExt as _, StreamExt as _};
use http::{HeaderValue, Method};
use serde_json::{Value, json};
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;
use wsg_gateway::access::Right;
use wsg_gateway::model::Urgency;
use wsg_gateway::operations::{Operation, all};

use crate::harness::wsg::Driver;
use crate::harness::{DEADLINE, Directory, Gateway, Socket, ZenohClient, eventually, socket_request};

/// Arguments of `token create` for each kind of client, and its rights to the gripper `g`.
const CLIENTS: &[(&str, &[Right])] = &[
    ("--name boss --role supervisor", &[Right::FastStop, Right::Stop, Right::Read, Right::Operate, Right::Supervise]),
    ("--name robot --role operator --gripper g", &[Right::FastStop, Right::Stop, Right::Read, Right::Operate]),
    ("--name other --role operator --gripper h", &[Right::FastStop, Right::Read]),
    ("--name panel --role observer", &[Right::FastStop, Right::Read]),
    ("--name curtain --role stop", &[Right::FastStop, Right::Stop]),
    ("--name far-curtain --role stop --gripper h", &[Right::FastStop]),
];

/// Whether a client with these rights may perform an operation on `g`. Only clients of all grippers may change
/// something that belongs to no gripper.
fn may(token: &str, rights: &[Right], operation: &Operation) -> bool {
    let is_of_all = !token.contains("--gripper") || operation.is_of_gripper();
    let is_free = matches!(operation.right, Right::FastStop | Right::Read);
    rights.contains(&operation.right) && (is_free || is_of_all)
}

fn values() -> BTreeMap<&'static str, &'static str> {
    BTreeMap::from([
        ("gripper", "g"),
        ("command", "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f"),
        ("finger", "1"),
        ("webhook", "mes"),
        ("id", "1"),
    ])
}

fn path(operation: &Operation) -> String {
    let values = values();
    let parts =
        operation.path.split('/').map(|part| match part.strip_prefix('{').and_then(|part| part.strip_suffix('}')) {
            Some(key) => values.get(key).copied().unwrap_or("x"),
            None => part,
        });
    format!("/api/v1{}", parts.collect::<Vec<_>>().join("/"))
}

async fn guarded() -> (Gateway, Vec<String>) {
    let tokens: Vec<_> = CLIENTS.iter().map(|(token, _)| *token).collect();
    Gateway::guarded(&tokens, &[]).await
}

#[tokio::test]
async fn each_role_may_do_what_it_is_for_over_http() {
    let (gateway, secrets) = guarded().await;
    for operation in all() {
        let ask = async |secret: &str| {
            let method = Method::from_bytes(operation.verb.as_str().as_bytes()).unwrap();
            let request = gateway.request(method.as_str(), &format!("{}?wait_ms=0", path(operation)));
            gateway.send(request.header("Authorization", format!("Bearer {secret}"))).await
        };
        for ((token, rights), secret) in CLIENTS.iter().zip(&secrets) {
            let answer = ask(secret).await;
            let is_refused = answer.status == 403 && answer.body["code"] == "forbidden";
            assert!(answer.status != 401, "{token}: {}", operation.name);
            assert_eq!(is_refused, !may(token, rights, operation), "{token}: {} {}", operation.name, answer.body);
        }
        let stranger = ask(&secrets[0].replace("wsg_", "wsg_A")).await;
        // On loopback, a FAST STOP is open to anyone.
        let may_stop = operation.urgency == Urgency::FastStop;
        assert_eq!(stranger.status, if may_stop { 200 } else { 401 }, "{}: {}", operation.name, stranger.body);
    }
}

#[tokio::test]
async fn each_role_may_do_what_it_is_for_over_websocket() {
    let (gateway, secrets) = guarded().await;
    for ((token, rights), secret) in CLIENTS.iter().zip(&secrets) {
        let mut request = socket_request(&gateway);
        let header = HeaderValue::try_from(format!("Bearer {secret}")).unwrap();
        request.headers_mut().insert("Authorization", header);
        let (mut socket, _) = connect_async(request).await.unwrap();
        for operation in all() {
            let keys = operation.path_parameters();
            let params: BTreeMap<_, _> = keys.map(|key| (key, values().get(key).copied().unwrap_or("x"))).collect();
            let call = json!({"jsonrpc": "2.0", "id": operation.name, "method": operation.name, "params": params});
            socket.send(Message::text(call.to_string())).await.unwrap();
            let answer = loop {
                let Message::Text(text) = socket.next().await.unwrap().unwrap() else { continue };
                let message: Value = serde_json::from_str(&text).unwrap();
                if message["id"] == operation.name {
                    break message;
                }
            };
            let is_refused = answer["error"]["data"]["code"] == "forbidden";
            assert_eq!(is_refused, !may(token, rights, operation), "{token}: {} {answer}", operation.name);
        }
        let subscribe = json!({"jsonrpc": "2.0", "id": "subscribe", "method": "subscribe", "params": {}});
        socket.send(Message::text(subscribe.to_string())).await.unwrap();
        let answer = loop {
            let Message::Text(text) = socket.next().await.unwrap().unwrap() else { continue };
            let message: Value = serde_json::from_str(&text).unwrap();
            if message["id"] == "subscribe" {
                break message;
            }
        };
        let is_refused = answer["error"]["data"]["code"] == "forbidden";
        assert_eq!(is_refused, !rights.contains(&Right::Read), "{token}: {answer}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn zenoh_client_needs_a_token_for_changes() {
    let (gateway, secrets) = guarded().await;
    let client = ZenohClient::of(&gateway).await;
    let ask = async |name: &str, token: &str| {
        client.ask(&format!("wsg/v1/gateway/g/command/{name}?token={token}"), &json!({})).await
    };
    let code = |answer: Result<Value, Value>| answer.err().map_or(Value::Null, |problem| problem["code"].clone());
    assert_eq!(code(ask("state", "").await), Value::Null, "the network's own access control decides who reads");
    assert_eq!(code(ask("home", "").await), "forbidden");
    assert_eq!(code(ask("home", "nonsense").await), "unauthorized");
    assert_eq!(code(ask("home", &secrets[3]).await), "forbidden");
    assert_eq!(code(ask("home", &secrets[1]).await), Value::Null);
    assert_eq!(code(ask("fast-stop", "").await), Value::Null);
}

#[tokio::test(flavor = "multi_thread")]
async fn bound_lease_ends_with_the_token_of_its_holder() {
    let (gateway, secrets) = guarded().await;
    let (robot, other) = (ZenohClient::of(&gateway).await, ZenohClient::of(&gateway).await);
    let _token = robot.live(&other, "wsg/v1/gateway/client/robot-1").await;
    let take = format!("lease.take?token={}", secrets[1]);
    let lease = robot.command(&take, &json!({"holder": "robot-1"})).await.unwrap();
    assert_eq!(lease["bound_to"], "token", "{lease}");
    gateway.revoke("robot").await;
    gateway.until("the lease is free", |state| state["lease_holder"].is_null()).await;
    let events = gateway.events("kind=lease", 2).await;
    assert_eq!((&events[0]["event"], &events[0]["cause"]), (&json!("lost"), &json!("forbidden")), "{events:?}");
}

#[tokio::test]
async fn routes_without_an_operation_need_the_right_to_read() {
    let (gateway, secrets) = guarded().await;
    let status = async |path: &str, secret: Option<&str>| {
        let client = reqwest::Client::new().get(gateway.url(path));
        let request = secret.map_or(client.try_clone().unwrap(), |secret| client.bearer_auth(secret));
        request.send().await.unwrap().status().as_u16()
    };
    let observer = Some(&*secrets[3]);
    eventually("the gateway is ready", async || (status("/readyz", observer).await == 200).then_some(())).await;
    for path in ["/metrics", "/api/v1/events", "/api/v1/grips.csv", "/api/v1/stream", "/api/v1/fleet/events"] {
        assert_eq!(status(path, None).await, 401, "{path}");
        assert_eq!(status(path, Some(&secrets[4])).await, 403, "{path}");
        assert_eq!(status(path, observer).await, 200, "{path}");
    }
    assert_eq!(status("/api/v1/ws", None).await, 401);
    // A load balancer has no token. The causes are for clients that may read.
    let stop_only = Some(&*secrets[4]);
    for secret in [None, stop_only] {
        let client = reqwest::Client::new().get(gateway.url("/readyz"));
        let request = secret.map_or(client.try_clone().unwrap(), |secret| client.bearer_auth(secret));
        let response = request.send().await.unwrap();
        assert_eq!(response.status().as_u16(), 200);
        assert_eq!(response.text().await.unwrap(), "ready\n");
    }
    assert_eq!(status("/readyz", Some("wsg_unknown")).await, 401);
    for path in ["/", "/healthz", "/docs/guide", "/python/", "/api/v1/openapi.json"] {
        assert_eq!(status(path, None).await, 200, "{path}");
    }
}

#[tokio::test]
async fn client_is_named_by_its_token() {
    let (gateway, secrets) = guarded().await;
    let me = gateway.send(reqwest::Client::new().get(gateway.url("/api/v1/me")).bearer_auth(&secrets[1])).await.ok();
    let rights = json!([{"gripper": "g", "role": "operator"}, {"gripper": "h", "role": "observer"}]);
    assert_eq!((&me["name"], &me["role"], &me["proof"]), (&json!("robot"), &json!("operator"), &json!("token")));
    assert_eq!(me["grippers"], rights);
    let request = reqwest::Client::new().post(gateway.url("lease")).bearer_auth(&secrets[1]);
    let lease = gateway.send(request.json(&json!({}))).await.ok();
    assert_eq!(lease["holder"], "robot");
    let force =
        reqwest::Client::new().post(gateway.url("lease")).bearer_auth(&secrets[1]).json(&json!({"force": true}));
    gateway.send(force).await.problem(403, "forbidden");
    let [event] = gateway.events("kind=lease", 1).await.try_into().unwrap();
    assert_eq!(event["subject"], "robot", "{event}");
}

#[tokio::test]
async fn revoked_token_is_refused_at_once() {
    let (gateway, secrets) = guarded().await;
    let mut request = socket_request(&gateway);
    let header = HeaderValue::try_from(format!("Bearer {}", secrets[1])).unwrap();
    request.headers_mut().insert("Authorization", header);
    let mut socket = Socket::with(request).await.unwrap();
    socket.call("state", json!({"gripper": "g"})).await;
    gateway.revoke("robot").await;
    let error = socket.refused("state", json!({"gripper": "g"})).await;
    assert_eq!(error["data"]["code"], "unauthorized", "{error}");
    while socket.next().await.is_some() {}
}

#[tokio::test]
async fn stream_ends_with_the_right_to_read() {
    let (gateway, secrets) = guarded().await;
    let stream = reqwest::Client::new().get(gateway.url("/api/v1/stream?topics=state")).bearer_auth(&secrets[1]);
    let mut stream = stream.send().await.unwrap();
    assert!(stream.chunk().await.unwrap().is_some());
    gateway.revoke("robot").await;
    let ended = async { while let Ok(Some(_)) = stream.chunk().await {} };
    tokio::time::timeout(DEADLINE, ended).await.unwrap();
}

#[tokio::test]
async fn session_does_not_work_from_pages_of_other_origins() {
    let files = Directory::new();
    let file = files.write("gateway.toml", "cors_origins = [\"https://hmi.example\"]\n");
    let (gateway, secrets) = Gateway::guarded(&["--name robot --role operator"], &["--config", &file]).await;
    let browser = reqwest::Client::new();
    let signed_in = browser.post(gateway.url("/api/v1/session")).json(&json!({"token": secrets[0]}));
    let cookie = signed_in.send().await.unwrap().headers()["set-cookie"].to_str().unwrap().to_owned();
    let request = |method: Method, path: &str| {
        browser.request(method, gateway.url(path)).header("Cookie", cookie.split(';').next().unwrap())
    };
    let me = || request(Method::GET, "/api/v1/me");
    let foreign = |method, path| request(method, path).header("Origin", "https://hmi.example");
    assert_eq!(gateway.send(me()).await.ok()["proof"], "session");
    gateway.send(foreign(Method::GET, "/api/v1/me")).await.problem(401, "unauthorized");
    let pin = foreign(Method::POST, "/api/v1/session/pin").json(&json!({"pin": "000000"}));
    let refused = gateway.send(pin).await.problem(401, "unauthorized");
    assert!(refused["detail"].as_str().unwrap().contains("session has ended"), "{refused}");
    let signed_out = foreign(Method::DELETE, "/api/v1/session").send().await.unwrap();
    assert_eq!((signed_out.status().as_u16(), signed_out.headers().get("set-cookie")), (204, None));
    assert_eq!(gateway.send(me()).await.ok()["proof"], "session", "the session is still open");
}

#[tokio::test]
async fn browser_signs_in_and_out() {
    let (gateway, secrets) = guarded().await;
    let browser = reqwest::Client::new();
    let url = gateway.url("/api/v1/session");
    let refused = browser.post(&url).json(&json!({"token": "wsg_wrong"})).send().await.unwrap();
    assert_eq!(refused.status(), 401);
    let signed_in = browser.post(&url).json(&json!({"token": secrets[1]})).send().await.unwrap();
    let cookie = signed_in.headers()["set-cookie"].to_str().unwrap().to_owned();
    assert!(cookie.ends_with("; Path=/; HttpOnly; SameSite=Strict") && !cookie.contains(&secrets[1]), "{cookie}");
    assert_eq!(signed_in.json::<Value>().await.unwrap(), json!({"name": "robot", "role": "operator"}));
    let id = cookie.split(';').next().unwrap();
    let me = || gateway.send(browser.get(gateway.url("/api/v1/me")).header("Cookie", id));
    assert_eq!(me().await.ok()["proof"], "session");
    let foreign = browser.post(gateway.url("home")).header("Cookie", id).header("Origin", "http://evil.example");
    gateway.send(foreign).await.problem(403, "foreign_origin");
    browser.delete(&url).header("Cookie", id).send().await.unwrap();
    me().await.problem(401, "unauthorized");
}

#[tokio::test]
async fn missing_token_file_is_reported_unless_clients_are_known_otherwise() {
    let missing = "token file missing, so tokens are refused";
    let gateway = Gateway::with_file(&[], "[access]\ntokens = \"nosuch.json\"\n").await;
    gateway.until_logged(missing).await;
    assert!(gateway.log().contains("nosuch.json"), "{}", gateway.log());
    let (gateway, _port) = port_of_known_clients("observer").await;
    assert!(!gateway.log().contains(missing), "{}", gateway.log());
}

#[tokio::test]
async fn reload_without_a_token_names_its_own_options() {
    let (gateway, _) = guarded().await;
    let ended = crate::harness::run(&["reload", "--url", &gateway.url("/")]).await;
    assert!(!ended.status.success() && ended.stderr.contains("pass --token-file FILE, or set WSG_GATEWAY_TOKEN"));
}

#[tokio::test]
async fn only_known_clients_see_the_names_of_grippers() {
    let (gateway, secrets) = guarded().await;
    let home = gateway.url("/api/v1/grippers/lefft/home");
    let other = reqwest::Client::new().post(&home).bearer_auth(&secrets[2]);
    let missing = gateway.send(other).await.problem(404, "not_found");
    assert_eq!(missing["detail"], "no gripper is named lefft: this gateway has g, h");
    let stop = gateway.url("/api/v1/grippers/lefft/fast-stop");
    for (path, status, code) in [(&home, 401, "unauthorized"), (&stop, 404, "not_found")] {
        let refused = gateway.send(reqwest::Client::new().post(path)).await.problem(status, code);
        assert!(!refused["detail"].as_str().unwrap().contains("this gateway has"), "{refused}");
    }
}

#[tokio::test]
async fn fast_stop_needs_a_credential_if_configured() {
    let files = Directory::new();
    let file = files.write("gateway.toml", "[access]\nfast_stop = \"credential\"\n");
    let (gateway, secrets) = Gateway::guarded(&["--name curtain --role stop"], &["--config", &file]).await;
    let stop = || reqwest::Client::new().post(gateway.url("/api/v1/fast-stop"));
    gateway.send(stop()).await.problem(401, "unauthorized");
    gateway.send(stop().bearer_auth(&secrets[0])).await.ok();
}

/// A gateway with a WSG port for `g`, and its address. Clients on loopback are known as `plc`, with this role.
async fn port_of_known_clients(role: &str) -> (Gateway, std::net::SocketAddr) {
    let toml = format!(
        "[[clients]]\nname = \"plc\"\naddress = \"127.0.0.1\"\nrole = \"{role}\"\n\
         [grippers.g]\nurl = \"sim://wsg50\"\nwsg_port = \"127.0.0.1:0\"\n"
    );
    let gateway = Gateway::with_file(&[], &toml).await;
    let port = gateway.word_after("WSG port of g: tcp://").await.parse().unwrap();
    gateway.until_link("connected").await;
    (gateway, port)
}

#[tokio::test]
async fn known_client_has_its_role_on_the_wsg_port() {
    let (_gateway, port) = port_of_known_clients("observer").await;
    let mut driver = Driver::connect(port).await;
    assert_eq!(driver.status(0x43, &[0, 0, 0]).await, 0, "a read");
    assert_eq!(driver.status(0x20, &[0]).await, E_ACCESS_DENIED, "a motion");
    assert_eq!(driver.status(0x22, &[]).await, E_ACCESS_DENIED, "a Stop");
    assert_eq!(driver.status(0x23, &[]).await, 0, "a FAST STOP");
    driver.leave().await;

    let (gateway, port) = port_of_known_clients("supervisor").await;
    let mut driver = Driver::connect(port).await;
    assert_eq!(driver.run(0x20, &[0]).await, 0);
    driver.leave().await;
    let events = gateway.events("kind=command", 2).await;
    assert!(events.iter().all(|event| event["subject"] == "plc"), "{events:?}");
}

/// Status of a refused request (`fw4-en 3.1.3`).
const E_ACCESS_DENIED: u16 = 16;
