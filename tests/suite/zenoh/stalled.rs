//! A client that stops reading delays no other client.

use serde_json::{Value, json};
use zenoh::qos::{CongestionControl, Priority};

use super::fleet;
use crate::harness::{Directory, Gateway, Simulator, Socket, ZenohClient, eventually};

/// A client that stops reading, with its buffers filled by a flood of other messages.
async fn stalled(endpoint: &str) -> (ZenohClient, std::sync::mpsc::Sender<()>) {
    let client = ZenohClient::at(&format!("{endpoint}#so_rcvbuf=4096")).await;
    let (resume, resumed) = std::sync::mpsc::channel();
    let (resumed, (stalls, mut has_stalled)) = (std::sync::Mutex::new(resumed), tokio::sync::mpsc::channel(1));
    let wait = move |_| {
        let _ = stalls.try_send(());
        // Zenoh's threads also serve the clients of other tests.
        let _ = tokio::task::block_in_place(|| resumed.lock().unwrap().recv());
    };
    client.session.declare_subscriber("wsg/v1/**").callback(wait).background().await.unwrap();
    has_stalled.recv().await.unwrap();
    let flood = ZenohClient::at(endpoint).await;
    for _ in 0..2000 {
        let put = flood.session.put("wsg/v1/flood", vec![0; 1000]).priority(Priority::DataHigh);
        put.congestion_control(CongestionControl::Drop).await.unwrap();
    }
    (client, resume)
}

#[tokio::test(flavor = "multi_thread")]
async fn others_get_publications_and_replies() {
    let device = Simulator::start(&[]).await;
    let gripper = format!("g=tcp://{}", device.address);
    let gateway = Gateway::start(&["--gripper", &gripper, "--zenoh-listen", "tcp/127.0.0.1:0#so_sndbuf=4096"]).await;
    gateway.until_link("connected").await;
    let endpoint = gateway.word_after("Zenoh: ").await;
    let client = ZenohClient::at(&endpoint).await;
    let received = client.subscribe("wsg/v1/gateway/g/*").await;
    let (_stalled, _resume) = stalled(&endpoint).await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    for round in 0..5 {
        let width_mm = if round % 2 == 0 { 50 } else { 60 };
        let answer = client.command("move", &json!({"width_mm": width_mm, "speed_mm_s": 400})).await.unwrap();
        assert_eq!(answer["outcome"], "SUCCESS", "{answer}");
    }
    client.put("wsg/v1/fast-stop", "now").await;
    gateway.until("the gripper stops", |state| state["fast_stop_confirmed"] == true).await;
    let is_done = |event: &&Value| event["kind"] == "command" && event["phase"] == "done";
    eventually("the ends of all commands", async || {
        (received.of("wsg/v1/gateway/g/event").iter().filter(is_done).count() == 6).then_some(())
    })
    .await;
}

/// Configuration for a gateway that queues few bytes for a client, and keeps one that reads nothing.
const PATIENT: &str = r#"{"transport": {"link": {"tx": {"batch_size": 1024, "queue": {
    "congestion_control": {"block": {"wait_before_close": 60000000}}}}}}}"#;

/// Starts such a gateway, and returns it with its Zenoh endpoint.
async fn patient() -> (Gateway, String) {
    let files = Directory::new();
    let own = files.write("zenoh.json5", PATIENT);
    let toml = files.write("gateway.toml", &format!("[zenoh]\nconfig = {own:?}\n"));
    let listen = ["--zenoh-listen", "tcp/127.0.0.1:0#so_sndbuf=4096"];
    let near = ["--name", "near", "--gripper", "g=sim://wsg50", "--config", &toml];
    let near = Gateway::start(&[&near[..], &listen].concat()).await;
    let endpoint = near.word_after("Zenoh: ").await;
    (near, endpoint)
}

/// Sends queries without reading the replies, which have the same priority. Returns once the gateway has received them.
async fn ask(stalled: &ZenohClient, key: &str, priority: Priority, times: usize, other: &ZenohClient) {
    for _ in 0..times {
        stalled.session.get(key).priority(priority).callback(|_| ()).await.unwrap();
    }
    let received = other.subscribe("all/sent").await;
    eventually("the last message of the client that reads nothing", async || {
        stalled.session.put("all/sent", "").priority(Priority::DataLow).await.unwrap();
        (!received.all().is_empty()).then_some(())
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn others_can_stop_grippers_here_and_of_other_gateways() {
    let (near, endpoint) = patient().await;
    let far = fleet::gateway("far", &endpoint, 0, &["g=sim://wsg50".to_owned()]).await;
    fleet::until_whole(&near, 2).await;
    let client = ZenohClient::at(&endpoint).await;
    let (stalled, _resume) = stalled(&endpoint).await;

    ask(&stalled, "wsg/v1/near/g/command/fast-stop", Priority::RealTime, 200, &client).await;
    near.until("the gripper stops", |state| state["fast_stop_confirmed"] == true).await;
    eventually("the FAST STOP of another client", async || {
        client.session.get("wsg/v1/near/g/command/fast-stop?client=robot").callback(|_| ()).await.unwrap();
        let events = near.get("/api/v1/events?kind=fast_stop&limit=500").await.ok();
        events["events"].as_array().unwrap().iter().any(|event| event["subject"] == "zenoh:robot").then_some(())
    })
    .await;

    // More than Tokio has threads for work that can block.
    ask(&stalled, "wsg/v1/near/g/state", Priority::DataHigh, 1000, &client).await;
    near.post("/api/v1/fleet/fast-stop", &json!({})).await;
    far.until("the gripper of the other gateway stops", |state| state["fast_stop_confirmed"] == true).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn websockets_are_served_while_publications_wait() {
    let (near, endpoint) = patient().await;
    near.until_link("connected").await;
    let client = ZenohClient::at(&endpoint).await;
    let (stalled, _resume) = stalled(&endpoint).await;
    let mut socket = Socket::open(&near).await;
    // States have the same priority.
    ask(&stalled, "wsg/v1/near/g/info", Priority::Data, 100, &client).await;
    for direction in ["outer", "inner", "outer"] {
        near.post("home", &json!({"direction": direction})).await.outcome("SUCCESS");
        let state = socket.call("state", json!({"gripper": "g"})).await;
        assert_eq!(state["referenced"], true, "{state}");
    }
}
