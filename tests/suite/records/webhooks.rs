//! Webhooks of a real gateway, over restarts.

use axum::Router;
use axum::http::{HeaderMap, StatusCode};
use axum::routing::post;
use serde_json::{Value, json};
use tokio::net::TcpListener;
use tokio::sync::mpsc;

use crate::harness::{Gateway, JournalFile, eventually};
use crate::installation::reload::Configured;

const SECRET: &str = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw";

/// Id and body of a delivery.
type Delivered = (String, Value);

/// Accepts all deliveries. Returns the address and the deliveries.
async fn receiver() -> (String, mpsc::Receiver<Delivered>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let (sender, deliveries) = mpsc::channel(1024);
    let receive = move |headers: HeaderMap, body: String| {
        let sender = sender.clone();
        async move {
            let id = headers["webhook-id"].to_str().unwrap().to_owned();
            sender.send((id, serde_json::from_str(&body).unwrap())).await.unwrap();
            StatusCode::NO_CONTENT
        }
    };
    let router = Router::new().route("/hooks/s3cret", post(receive));
    tokio::spawn(async move { axum::serve(listener, router).await.unwrap() });
    (address, deliveries)
}

struct Rig {
    journal: JournalFile,
    address: String,
    deliveries: mpsc::Receiver<Delivered>,
}

impl Rig {
    async fn new() -> Self {
        let (address, deliveries) = receiver().await;
        Self { journal: JournalFile::new(), address, deliveries }
    }

    async fn start(&self) -> Gateway {
        let toml = format!(
            "[grippers.g]\nurl = \"sim://wsg50\"\n[[webhooks]]\nname = \"mes\"\nkinds = [\"fast_stop\", \"gateway\"]\n\
             url = \"http://{}/hooks/s3cret\"\nsecret = \"{SECRET}\"\n",
            self.address
        );
        let gateway = Gateway::with_file(&["--journal", &self.journal.path()], &toml).await;
        gateway.until_link("connected").await;
        gateway
    }

    /// Returns the next delivery: its id, and the `seq` and `event` of its body.
    async fn next(&mut self) -> (String, i64, String) {
        let (id, body) = self.deliveries.recv().await.unwrap();
        (id, body["seq"].as_i64().unwrap(), body["event"].as_str().unwrap().to_owned())
    }
}

#[tokio::test]
async fn deliveries_continue_after_a_restart_and_repeat_after_a_kill() {
    let mut rig = Rig::new().await;
    let gateway = rig.start().await;
    gateway.post("fast-stop", &json!({})).await.ok();
    // On a slow disk, the records of the start may be written only after the webhook begins.
    let first = loop {
        match rig.next().await {
            (_, seq, event) if event == "latched" => break seq,
            (_, _, event) => assert!(["started", "configuration"].contains(&event.as_str()), "{event}"),
        }
    };
    let (_, second, event) = rig.next().await;
    assert!(second > first && event == "confirmed", "{second} {event}");
    let listed = eventually("nothing waiting", async || {
        let listed = gateway.get("/api/v1/webhooks").await.ok();
        (listed["webhooks"][0]["waiting"] == 0).then_some(listed)
    })
    .await;
    assert_eq!(listed["webhooks"][0]["origin"], format!("http://{}", rig.address));
    assert!(!listed.to_string().contains("s3cret"), "{listed}");
    let ended = gateway.terminate().await;
    assert!(ended.status.success() && !ended.stderr.contains("s3cret") && !ended.stderr.contains(SECRET), "{ended:?}");

    let gateway = rig.start().await;
    let (_, third, event) = rig.next().await;
    assert!(third > second && event == "ended", "{third} {event}");
    assert_eq!(rig.next().await.2, "started");
    assert_eq!(rig.next().await.2, "configuration");
    gateway.post("fast-stop", &json!({})).await.ok();
    let (id, fourth, _) = rig.next().await;
    gateway.kill().await;

    // Deliveries whose position was not stored yet are repeated with their ids; none is lost.
    let _gateway = rig.start().await;
    let mut seen = Vec::new();
    while seen.last().is_none_or(|(_, _, event)| event != "unclean_end") {
        seen.push(rig.next().await);
    }
    for (repeated, ..) in seen.iter().filter(|(_, seq, _)| *seq == fourth) {
        assert_eq!(*repeated, id);
    }
}

#[tokio::test]
async fn webhook_is_tested_over_http() {
    let mut rig = Rig::new().await;
    let gateway = rig.start().await;
    let tested = gateway.post("/api/v1/webhooks/mes/test", &json!({})).await.ok();
    assert_eq!((&tested["delivered"], &tested["status"], &tested["error"]), (&json!(true), &json!(204), &Value::Null));
    assert_eq!(rig.deliveries.recv().await.unwrap().1["kind"], "test");
    gateway.post("/api/v1/webhooks/other/test", &json!({})).await.problem(404, "not_found");
    gateway.post("/api/v1/webhooks/mes/test", &json!({"url": "http://127.0.0.1"})).await.problem(400, "malformed");
}

#[tokio::test]
async fn reload_adds_changes_and_removes_webhooks() {
    let g = "[grippers.g]\nurl = \"sim://wsg50\"\n";
    let [(first, mut at_first), (second, mut at_second)] = [receiver().await, receiver().await];
    let to = |address: &str| {
        format!(
            "{g}[[webhooks]]\nname = \"mes\"\nkinds = [\"gateway\"]\nurl = \"http://{address}/hooks/s3cret\"\n\
             secret = \"{SECRET}\"\n"
        )
    };
    let one = Configured::start(g).await;
    assert_eq!(one.reload(&to(&first)).await, json!(["webhook mes: added"]));
    // The events of the reloads themselves are delivered.
    assert_eq!(at_first.recv().await.unwrap().1["changes"], json!(["webhook mes: added"]));
    assert_eq!(one.reload(&to(&second)).await, json!(["webhook mes: changed"]));
    assert_eq!(at_second.recv().await.unwrap().1["changes"], json!(["webhook mes: changed"]));
    eventually("the delivery is noted", async || {
        let listed = one.gateway.get("/api/v1/webhooks").await.ok();
        (listed["webhooks"][0]["waiting"] == 0).then_some(())
    })
    .await;
    assert_eq!(one.reload(g).await, json!(["webhook mes: removed"]));
    assert_eq!(one.gateway.get("/api/v1/webhooks").await.ok(), json!({"webhooks": []}));
    assert!(!one.gateway.figures().await.keys().any(|name| name.starts_with("wsg_webhook")));
    // A webhook that comes back misses nothing.
    assert_eq!(one.reload(&to(&second)).await, json!(["webhook mes: added"]));
    for change in ["removed", "added"] {
        let (_, body) = at_second.recv().await.unwrap();
        assert_eq!(body["changes"], json!([format!("webhook mes: {change}")]), "{body}");
    }
    assert!(at_first.try_recv().is_err());
}
