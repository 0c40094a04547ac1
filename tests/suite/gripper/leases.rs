//! The lease over HTTP: waiting PLCs, lost and frozen clients, hand-over, and a restart of the gateway.

use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;

use crate::harness::{Gateway, JournalFile, Proxy, Simulator, eventually, shortest};

const FAST_STOP: u8 = 0x23;
const STOP: u8 = 0x22;

fn slow() -> Value {
    json!({"width_mm": 10, "speed_mm_s": 10})
}

async fn take(gateway: &Gateway, holder: &str, ttl_ms: u64) -> String {
    gateway.post("lease", &json!({"holder": holder, "ttl_ms": ttl_ms})).await.text("token")
}

async fn moved(gateway: &Gateway, token: &str, body: &Value) -> crate::harness::Answer {
    gateway.send(gateway.request("POST", "move?wait_ms=20000").header("Wsg-Lease", token).json(body)).await
}

/// Opens a connection that starts a motion and waits for its end. `rest` follows the request.
async fn client_with(gateway: &Gateway, token: &str, rest: &str) -> TcpStream {
    let url = gateway.url("move?wait_ms=20000");
    let (host, path) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
    let body = slow().to_string();
    let request = format!(
        "POST /{path} HTTP/1.1\r\nHost: {host}\r\nWsg-Lease: {token}\r\nContent-Length: {}\r\n\r\n{body}{rest}",
        body.len()
    );
    let mut stream = TcpStream::connect(host).await.unwrap();
    stream.write_all(request.as_bytes()).await.unwrap();
    gateway.until_moving().await;
    stream
}

async fn client(gateway: &Gateway, token: &str) -> TcpStream {
    client_with(gateway, token, "").await
}

#[tokio::test]
async fn holder_killed_during_a_motion_is_a_fast_stop() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let (longest, mut rounds) = (Duration::from_millis(550), 0);
    let after = shortest(longest, async || {
        let token = take(&gateway, "robot", 500).await;
        let client = client(&gateway, &token).await;
        let killed = Instant::now();
        drop(client);
        let stopped = eventually("23h", async || proxy.frames.first_since(FAST_STOP, killed)).await;
        let state = gateway.until("the latch", |state| state["fast_stop_confirmed"] == true).await;
        let causes = (&state["fast_stop_cause"], &state["lease_holder"]);
        assert_eq!(causes, (&json!("client_lost"), &Value::Null), "{state}");
        assert_eq!(state["fast_stop_reason"], "lease holder robot lost");
        let sent = proxy.frames.count(FAST_STOP);
        rounds += 1;
        let events = gateway.events("kind=lease&order=newest", 2 * rounds).await;
        let steps: Vec<_> = events.iter().take(2).map(|event| &event["event"]).collect();
        assert_eq!(steps, ["lost", "taken"]);
        assert_eq!(proxy.frames.count(FAST_STOP), sent, "no repeat after the confirmation");
        gateway.post("acknowledge", &json!({"fast_stop_id": state["fast_stop_id"]})).await.ok();
        stopped - killed
    })
    .await;
    assert!(after >= Duration::from_millis(400) && after <= longest, "{after:?}");
}

#[tokio::test]
async fn holder_killed_with_bytes_behind_its_request_is_a_fast_stop() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    for rest in ["\r\n", "GET /livez HTTP/1.1\r\n"] {
        let token = take(&gateway, "robot", 500).await;
        let client = client_with(&gateway, &token, rest).await;
        drop(client);
        let killed = Instant::now();
        let state = gateway.until("the latch", |state| state["fast_stop_confirmed"] == true).await;
        // The motion takes 10 s.
        assert!(killed.elapsed() < Duration::from_secs(5), "{rest:?}: {:?}", killed.elapsed());
        assert_eq!(state["fast_stop_reason"], "lease holder robot lost");
        gateway.post("acknowledge", &json!({"fast_stop_id": state["fast_stop_id"]})).await.ok();
        gateway.post("home", &json!({})).await.outcome("SUCCESS");
    }
}

#[tokio::test]
async fn holder_killed_with_a_part_leaves_it_held() {
    let device = Simulator::with_part().await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let token = take(&gateway, "robot", 1000).await;
    let grip = json!({"width_mm": 20, "speed_mm_s": 100, "lease": token});
    gateway.post("grip", &grip).await.outcome("PART_HELD");
    let sent = proxy.frames.len();
    gateway.until("the holder is lost", |state| state["lease_holder"] == Value::Null).await;
    let refused = gateway.post("move", &json!({"width_mm": 50, "speed_mm_s": 50})).await.problem(409, "reserved");
    assert_eq!((&refused["holder"], refused.get("expires_in_ms")), (&json!("robot"), None), "{refused}");
    let state = gateway.state().await;
    assert_eq!((&state["state"], &state["fast_stop"]), (&json!("HOLDING"), &json!(false)));
    assert!(proxy.frames.since(sent).iter().all(crate::harness::Frame::is_upkeep), "no command is sent");
    // The same holder can take the lease again, and open the gripper.
    let token = take(&gateway, "robot", 3000).await;
    let release = json!({"width_mm": 50, "speed_mm_s": 100, "lease": token});
    gateway.post("release", &release).await.outcome("SUCCESS");
}

#[tokio::test]
async fn release_stops_the_motion_without_a_latch() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let token = take(&gateway, "robot", 500).await;
    let client = client(&gateway, &token).await;
    gateway.send(gateway.request("DELETE", "lease").header("Wsg-Lease", &token)).await.ok();
    drop(client);
    gateway.until_standing().await;
    assert_eq!((proxy.frames.count(STOP), proxy.frames.count(FAST_STOP)), (1, 0));
    assert_eq!(gateway.state().await["fast_stop"], false);
}

#[tokio::test]
async fn waiting_for_a_slow_move_keeps_a_lease_of_500_ms() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let token = take(&gateway, "plc", 500).await;
    let command = moved(&gateway, &token, &json!({"width_mm": 60, "speed_mm_s": 10})).await.outcome("SUCCESS");
    assert!(command["duration_ms"].as_u64() >= Some(4500), "{command}");
    assert_eq!(gateway.state().await["lease_holder"], "plc");
    // Waiting for the end of a command that returned 202 keeps the lease too.
    let begun = gateway.request("POST", "move?wait_ms=0").header("Wsg-Lease", &token);
    let begun = gateway.send(begun.json(&json!({"width_mm": 70, "speed_mm_s": 5}))).await.text("id");
    let path = format!("commands/{begun}?wait_ms=20000");
    gateway.send(gateway.request("GET", &path).header("Wsg-Lease", &token)).await.outcome("SUCCESS");
}

#[tokio::test]
async fn client_frozen_past_its_lease_moves_nothing() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let a = take(&gateway, "a", 100).await;
    gateway.until("the lease has expired", |state| state["lease_holder"] == Value::Null).await;
    let b = take(&gateway, "b", 5000).await;
    moved(&gateway, &b, &json!({"width_mm": 90, "speed_mm_s": 200})).await.outcome("SUCCESS");
    let motions = proxy.frames.motions();
    let refused = moved(&gateway, &a, &slow()).await.problem(409, "stale_lease");
    assert_eq!(refused["holder"], "b", "{refused}");
    let setting = json!({"acceleration_mm_s2": 500, "lease": a});
    gateway.put("settings/acceleration", &setting).await.problem(409, "stale_lease");
    let held = gateway.put("settings/acceleration", &json!({"acceleration_mm_s2": 500})).await;
    assert!(held.problem(409, "lease_held")["expires_in_ms"].as_u64() <= Some(5000));
    gateway.post("tare", &json!({})).await.problem(409, "lease_held");
    assert_eq!(proxy.frames.motions(), motions);
    // Reads and Stops need no lease.
    gateway.get("settings/acceleration").await.ok();
    gateway.post("stop", &json!({})).await.outcome("SUCCESS");
}

#[tokio::test]
async fn frozen_gateway_keeps_the_lease_of_an_active_holder() {
    const TTL: Duration = Duration::from_secs(3);
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let token = take(&gateway, "robot", TTL.as_millis() as u64).await;
    gateway.begin("move", &json!({"width_mm": 10, "speed_mm_s": 5, "lease": token})).await;
    gateway.until_moving().await;
    gateway.freeze();
    let lease = json!({"lease": token});
    // The renewal waits in the socket.
    let renewed = gateway.put("lease", &lease);
    let thawed = async {
        tokio::time::sleep(TTL).await;
        gateway.thaw();
    };
    let (renewed, ()) = tokio::join!(renewed, thawed);
    renewed.ok();
    let state = gateway.until("the flags are known again", |state| !state["fast_stop"].is_null()).await;
    assert_eq!((&state["fast_stop"], &state["lease_holder"]), (&json!(false), &json!("robot")), "{state}");
    // A holder that stays silent is lost all the same.
    gateway.freeze();
    tokio::time::sleep(TTL).await;
    gateway.thaw();
    let state = gateway.until("the latch", |state| state["fast_stop"] == true).await;
    assert_eq!(state["fast_stop_cause"], "client_lost", "{state}");
}

#[tokio::test]
async fn lease_is_requested_and_handed_over() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let a = take(&gateway, "a", 5000).await;
    let asks = json!({"holder": "b", "request": true});
    let waiting = gateway.post("lease", &asks).await;
    assert_eq!((waiting.status, &waiting.body["place"], waiting.body.get("token")), (202, &json!(1), None));
    assert_eq!(waiting.body["holder"], "a", "{}", waiting.body);
    let renewed = gateway.put("lease", &json!({"lease": a})).await.ok();
    assert_eq!((&renewed["requested_by"], &renewed["token"]), (&json!("b"), &json!(a)), "the holder sees the request");
    gateway.post("lease/hand-over", &json!({"to": "c", "lease": a})).await.problem(400, "malformed");
    let given = gateway.post("lease/hand-over", &json!({"to": "b", "lease": a})).await.ok();
    assert_eq!((&given["holder"], &given["epoch"], given.get("token")), (&json!("b"), &json!(2), None));
    let taken = gateway.post("lease", &asks).await.ok();
    assert_eq!(taken["epoch"], 2);
    gateway.put("lease", &json!({"lease": a})).await.problem(409, "stale_lease");
    gateway.put("lease", &json!({"lease": taken["token"]})).await.ok();
    let current = gateway.get("lease").await.ok();
    assert_eq!((&current["holder"], current.get("token")), (&json!("b"), None), "{current}");
}

#[tokio::test]
async fn latch_and_epoch_survive_a_gateway_restart() {
    let device = Simulator::start(&[]).await;
    let journal = JournalFile::new();
    let gripper = format!("g=tcp://{}", device.address);
    let arguments = ["--gripper", &gripper, "--journal", &journal.path()];
    let gateway = Gateway::start(&arguments).await;
    gateway.until_link("connected").await;
    take(&gateway, "a", 60_000).await;
    let first = gateway.post("fast-stop", &json!({"reason": "first"})).await.text("fast_stop_id");
    let stopped = gateway.post("fast-stop", &json!({"reason": "light curtain"})).await.text("fast_stop_id");
    assert!(gateway.terminate().await.status.success());
    let gateway = Gateway::start(&arguments).await;
    let state = gateway.until("confirmed again", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!((&state["fast_stop_id"], &state["fast_stop_reason"]), (&json!(stopped), &json!("light curtain")));
    assert_eq!((&state["lease_epoch"], &state["lease_holder"]), (&json!(1), &Value::Null));
    gateway.post("acknowledge", &json!({"fast_stop_id": first})).await.problem(409, "stale_fast_stop");
    gateway.post("acknowledge", &json!({"fast_stop_id": stopped})).await.ok();
    assert_eq!(gateway.post("lease", &json!({})).await.ok()["epoch"], 2);
    // After a kill, the newest epoch may be missing from the journal.
    gateway.kill().await;
    let gateway = Gateway::start(&arguments).await;
    gateway.until_link("connected").await;
    assert!(gateway.post("lease", &json!({})).await.ok()["epoch"].as_u64() > Some(2));
}

#[tokio::test]
async fn reservation_ends_with_an_acknowledged_fast_stop() {
    let device = Simulator::start(&["--part-mm", "20"]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let token = take(&gateway, "plc-1", 500).await;
    let grip = json!({"width_mm": 20, "speed_mm_s": 200, "force_n": 30});
    let gripped = gateway.request("POST", "grip?wait_ms=20000").header("Wsg-Lease", &token).json(&grip);
    gateway.send(gripped).await.outcome("PART_HELD");
    gateway.until("the loss", |state| state["reserved_for"] == "plc-1").await;
    let release = json!({"width_mm": 60, "speed_mm_s": 200});
    gateway.post("release", &release).await.problem(409, "reserved");
    gateway.post("fast-stop", &json!({})).await.ok();
    let state = gateway.until("the confirmation", |state| state["fast_stop_confirmed"] == true).await;
    // Until it is acknowledged, nothing is known of the part.
    assert_eq!(state["reserved_for"], "plc-1");
    gateway.post("acknowledge", &json!({"fast_stop_id": state["fast_stop_id"]})).await.ok();
    gateway.until("the end of the reservation", |state| state["reserved_for"].is_null()).await;
    assert_eq!(gateway.get("status").await.ok()["holding"], false);
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    take(&gateway, "robot", 500).await;
}
