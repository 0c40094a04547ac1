//! Links that break, stall and recover, and devices that restart or are replaced.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::harness::wsg::Driver;
use crate::harness::{Gateway, Proxy, Simulator, eventually};

#[tokio::test]
async fn device_lost_during_a_move_leaves_an_unknown_outcome() {
    let device = Simulator::start(&[]).await;
    let mut proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let id = gateway.begin("move", &json!({"width_mm": 10, "speed_mm_s": 5})).await;
    gateway.until_moving().await;
    let motions = proxy.frames.motions();
    proxy.go_away().await;

    let ended = gateway.command(&id).await.outcome("UNKNOWN");
    assert_eq!((&ended["reached_goal"], &ended["status"]), (&json!(null), &json!(null)), "{ended}");
    let state = gateway.until_link("reconnecting").await;
    assert!(!state["link_cause"].as_str().unwrap().is_empty(), "{state}");
    gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 100})).await.problem(503, "link_down");
    let state = gateway.state().await;
    for value in ["age_ms", "width_mm", "state", "flags_raw", "fast_stop"] {
        assert_eq!(state[value], json!(null), "{value} of a device that is not there: {state}");
    }

    proxy.accept();
    let state = gateway.until_link("connected").await;
    assert_eq!(state["link_cause"], Value::Null, "{state}");
    let state = gateway.until("the device's FAST STOP", |state| state["fast_stop"] == true).await;
    assert_eq!(state["fast_stop_cause"], "unannounced_disconnect", "{state}");
    assert_eq!(proxy.frames.motions(), motions, "the motion was not sent again");
    assert_eq!(proxy.frames.count(0x24), 0, "nothing was acknowledged");
}

#[tokio::test]
async fn waiting_client_gets_unknown_with_200_on_a_lost_link() {
    let device = Simulator::start(&[]).await;
    let mut proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let body = json!({"width_mm": 10, "speed_mm_s": 5});
    let waiting = gateway.post("move?wait_ms=20000", &body);
    let breaking = async {
        gateway.until_moving().await;
        proxy.go_away().await;
    };
    let (answer, ()) = tokio::join!(waiting, breaking);
    answer.outcome("UNKNOWN");
}

async fn make_settings(gateway: &Gateway) {
    gateway.put("settings/acceleration", &json!({"acceleration_mm_s2": 2000})).await.ok();
    gateway.put("settings/force-limit", &json!({"force_n": 30})).await.ok();
    gateway.put("settings/soft-limits", &json!({"minus_mm": 10, "plus_mm": 60})).await.ok();
}

async fn settings(gateway: &Gateway) -> Vec<Value> {
    let mut settings = Vec::new();
    for setting in ["acceleration", "force-limit", "soft-limits"] {
        let mut value = gateway.get(&format!("settings/{setting}")).await.ok();
        value.as_object_mut().unwrap().remove("gripper");
        settings.push(value);
    }
    settings
}

/// Replaces the device behind the proxy while the link is down, and returns the number of frames before.
async fn replace(gateway: &Gateway, proxy: &mut Proxy, device: &Simulator) -> usize {
    proxy.go_away().await;
    gateway.until_link("reconnecting").await;
    let frames = proxy.frames.len();
    proxy.retarget(device.address);
    proxy.accept();
    gateway.until_link("connected").await;
    frames
}

#[tokio::test]
async fn restarted_device_gets_its_settings_again() {
    let device = Simulator::start(&[]).await;
    let mut proxy = Proxy::to(device.address);
    let gateway = Gateway::connected_to(proxy.address).await;
    make_settings(&gateway).await;
    let made = settings(&gateway).await;
    assert_eq!(made[0], json!({"acceleration_mm_s2": 2000.0}));
    assert_eq!(made[2], json!({"minus_mm": 10.0, "plus_mm": 60.0}));

    let restarted = Simulator::start(&[]).await;
    let before = replace(&gateway, &mut proxy, &restarted).await;
    assert_eq!(settings(&gateway).await, made);
    assert_eq!(proxy.frames.since(before).iter().filter(|frame| frame.is_motion()).count(), 0);
    let state = gateway.state().await;
    assert_eq!(state["referenced"], false, "no homing without a request: {state}");
}

#[tokio::test]
async fn replaced_device_gets_no_settings() {
    let device = Simulator::start(&[]).await;
    let mut proxy = Proxy::to(device.address);
    let gateway = Gateway::connected_to(proxy.address).await;
    let serial_number = gateway.get("").await.field("serial_number").clone();
    let untouched = settings(&gateway).await;
    make_settings(&gateway).await;

    let other = Simulator::with_another_serial_number().await;
    let before = replace(&gateway, &mut proxy, &other).await;
    assert_ne!(gateway.get("").await.field("serial_number"), &serial_number);
    assert_eq!(settings(&gateway).await, untouched);
    let set = proxy.frames.since(before).into_iter().find(|frame| matches!(frame.id, 0x30 | 0x32 | 0x34 | 0x36));
    assert_eq!(set, None);
}

#[tokio::test]
async fn device_absent_at_the_start_is_connected_later() {
    let device = Simulator::start(&[]).await;
    let mut proxy = Proxy::refusing(device.address);
    let gateway = Gateway::of(proxy.address).await;
    let state = gateway.until("the state has a link cause", |state| state["link_cause"].is_string()).await;
    assert_eq!((&state["link"], &state["fast_stop"]), (&json!("connecting"), &json!(null)), "{state}");
    assert_eq!((&state["state"], &state["age_ms"]), (&json!(null), &json!(null)), "{state}");
    gateway.post("home", &json!({})).await.problem(503, "link_down");
    gateway.get("settings/acceleration").await.problem(503, "link_down");
    proxy.accept();
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
}

#[tokio::test]
async fn half_open_link_blocks_motion_and_recovers() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let motions = proxy.frames.motions();
    proxy.stall(true);
    let stalled_at = Instant::now();
    let state = gateway.until_link("unresponsive").await;
    let noticed_after = stalled_at.elapsed();
    assert!((Duration::from_millis(1400)..Duration::from_millis(2500)).contains(&noticed_after), "{noticed_after:?}");
    assert!(state["link_cause"].as_str().unwrap().contains("nothing heard"), "{state}");
    gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 100})).await.problem(503, "link_down");
    gateway.get("settings/acceleration").await.problem(503, "link_down");

    proxy.stall(false);
    gateway.until_link("connected").await;
    assert_eq!(proxy.frames.motions(), motions);
    assert!(proxy.frames.all().iter().all(|frame| frame.connection == 0), "the connection was kept");
    let state = gateway.state().await;
    assert_eq!(state["fast_stop"], false, "{state}");
    gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 100})).await.outcome("SUCCESS");
}

#[tokio::test]
async fn persistent_half_open_link_is_closed_with_an_announcement() {
    let device = Simulator::start(&[]).await;
    let mut proxy = Proxy::to(device.address);
    let gateway = Gateway::connected_to(proxy.address).await;
    proxy.stall(true);
    gateway.until_link("unresponsive").await;
    proxy.refuse().await;
    let state = gateway.until_link("reconnecting").await;
    assert!(!state["link_cause"].as_str().unwrap().is_empty(), "{state}");
    // Bytes in transit arrive now: the device sees the announcement before the close, and does not stop.
    proxy.stall(false);
    proxy.accept();
    gateway.until_link("connected").await;
    let first: Vec<_> = proxy.frames.all().into_iter().filter(|frame| frame.connection == 0).collect();
    assert_eq!(first.last().map(|frame| frame.id), Some(0x07));
    let state = gateway.state().await;
    assert_eq!(state["fast_stop"], false, "{state}");
}

#[tokio::test]
async fn thousand_state_reads_cost_the_device_no_frame() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let before = proxy.frames.len();
    for _ in 0..1000 {
        let state = gateway.state().await;
        assert_eq!(state["link"], "connected", "{state}");
    }
    let caused: Vec<_> = proxy.frames.since(before).into_iter().filter(|frame| !frame.is_upkeep()).collect();
    assert_eq!(caused, []);
    // Upkeep follows the clock, not the reads: one temperature in 5 s, and nothing else while updates arrive.
    assert!(proxy.frames.len() - before < 100, "{:?}", proxy.frames.since(before));
}

#[tokio::test]
async fn updates_on_change_relieve_the_line() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let url = format!("tcp://{}", proxy.address);
    let toml = format!("[grippers.g]\nurl = \"{url}\"\nupdate_period_ms = 20\nupdates = \"changes\"\n");
    let gateway = Gateway::with_file(&[], &toml).await;
    gateway.until_link("connected").await;
    let switched_on: Vec<_> =
        proxy.frames.all().into_iter().filter(|frame| frame.id == 0x43).map(|frame| frame.payload).collect();
    assert_eq!(switched_on, [[3, 20, 0]]);
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    gateway.post("move", &json!({"width_mm": 20, "speed_mm_s": 100})).await.outcome("SUCCESS");
    let grip = eventually("the record", async || {
        let page = gateway.get("/api/v1/grips?kind=move").await.ok();
        page["grips"].get(0).cloned()
    })
    .await;
    assert!(grip["samples"].as_u64() > Some(10), "{grip}");

    // While the fingers stand still, the gateway reads each value once a second.
    let updates = async || gateway.figures().await["wsg_updates_total{gripper=\"g\"}"];
    let (before, polled) = (updates().await, proxy.frames.count(0x40));
    eventually("two polls", async || (proxy.frames.count(0x40) >= polled + 2).then_some(())).await;
    let received = updates().await - before;
    assert!(received < 50.0, "{received}");
    assert_eq!(gateway.state().await["link"], "connected");
}

#[tokio::test]
async fn released_gripper_serves_another_program_until_connect() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let id = gateway.begin("move", &json!({"width_mm": 10, "speed_mm_s": 50})).await;
    gateway.until_moving().await;
    let refused = gateway.post("disconnect", &json!({})).await.problem(409, "already_running");
    assert_eq!(refused["command"], id.as_str(), "{refused}");
    gateway.post("stop", &json!({})).await.ok();
    gateway.until_standing().await;

    let released = gateway.post("disconnect", &json!({})).await.ok();
    assert_eq!(released["link"], "released", "{released}");
    assert_eq!(proxy.frames.all().last().map(|frame| frame.id), Some(0x07));
    gateway.post("disconnect", &json!({})).await.ok();
    let down = gateway.post("home", &json!({})).await.problem(503, "link_down");
    assert!(down["detail"].as_str().unwrap().contains("`connect`"), "{down}");
    let mut other = Driver::connect(device.address).await;
    assert_eq!(other.flags().await & 1 << 12, 0, "the disconnect was announced");
    other.leave().await;

    let before = proxy.frames.len();
    let stopped = gateway.post("fast-stop", &json!({})).await.ok();
    assert_eq!(stopped["fast_stop_confirmed"], false, "{stopped}");
    gateway.post("connect", &json!({})).await.ok();
    gateway.until("the FAST STOP is confirmed", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!(proxy.frames.since(before)[0].id, 0x23);
    gateway.until_link("connected").await;
}

#[tokio::test]
async fn release_ends_attempts_to_connect() {
    let device = Simulator::start(&[]).await;
    let mut proxy = Proxy::refusing(device.address);
    let gateway = Gateway::of(proxy.address).await;
    gateway.until("an attempt fails", |state| state["link_cause"].is_string()).await;
    let released = gateway.post("disconnect", &json!({})).await.ok();
    assert_eq!(released["link"], "released", "{released}");
    proxy.accept();
    let connecting = gateway.post("connect", &json!({})).await.ok();
    assert_ne!(connecting["link"], "released", "{connecting}");
    gateway.until_link("connected").await;
}

#[tokio::test]
async fn motion_on_a_stalled_link_does_not_start_when_it_heals() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    proxy.stall(true);
    let ended = gateway.post("move", &json!({"width_mm": 50, "speed_mm_s": 200})).await.outcome("UNKNOWN");
    assert!(ended["detail"].as_str().unwrap().contains("a Stop after this command"), "{ended}");
    proxy.stall(false);
    let state = gateway.until("the Stop arrives", |state| state["flags"].to_string().contains("AXIS_STOPPED")).await;
    assert!(state["width_mm"].as_f64() > Some(100.0), "{state}");
    assert_eq!(proxy.frames.count(0x21), 1);
    assert!(proxy.frames.count(0x22) >= 1, "a Stop without a reply is repeated");
}

#[tokio::test]
async fn motion_that_was_never_received_ends_with_its_connection() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    proxy.stall(true);
    gateway.post("move", &json!({"width_mm": 50, "speed_mm_s": 200})).await.outcome("UNKNOWN");
    gateway.until_link("reconnecting").await;
    proxy.stall(false);
    let is_set_up = |state: &Value| state["fast_stop"] == true && state["width_mm"].is_number();
    let state = gateway.until("the device's FAST STOP", is_set_up).await;
    assert_eq!(state["fast_stop_cause"], "unannounced_disconnect", "the unsent bytes are gone with 07h: {state}");
    let width_mm = state["width_mm"].as_f64();
    assert!(width_mm > Some(100.0), "{state}");
}

#[tokio::test]
async fn cause_of_a_failed_setup_says_what_arrived() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let echo = tokio::spawn(async move {
        while let Ok((mut stream, _)) = listener.accept().await {
            let (mut reader, mut writer) = stream.split();
            let _ = tokio::io::copy(&mut reader, &mut writer).await;
        }
    });
    let gateway = Gateway::of(address).await;
    let told = |state: &Value| state["link_cause"].as_str().is_some_and(|cause| cause.contains("returned"));
    let state = gateway.until("the cause names the echo", told).await;
    let cause = state["link_cause"].as_str().unwrap();
    assert!(cause.starts_with("the device does not answer GetSystemInfo: the line returned"), "{cause}");
    echo.abort();
}

#[tokio::test]
async fn device_under_two_names_has_one_connection() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let port = proxy.address.port();
    let (named, by_address) = (format!("a=tcp://localhost:{port}"), format!("b=tcp://127.0.0.1:{port}"));
    let gateway = Gateway::start(&["--gripper", &named, "--gripper", &by_address]).await;
    let states = async || {
        let [a, b] = ["a", "b"].map(|name| format!("/api/v1/grippers/{name}/state"));
        [gateway.get(&a).await.ok(), gateway.get(&b).await.ok()]
    };
    let is_taken =
        |state: &Value| state["link_cause"].as_str().is_some_and(|cause| cause.contains(" is the device of "));
    let (served, refused) = eventually("one is served, the other refused", async || {
        let [a, b] = states().await;
        let (served, refused) = if a["link"] == "connected" { (a, b) } else { (b, a) };
        (served["link"] == "connected" && is_taken(&refused)).then_some((served, refused))
    })
    .await;
    let cause = refused["link_cause"].as_str().unwrap();
    assert!(cause.contains(&format!("the device of {} already", served["gripper"].as_str().unwrap())), "{cause}");
    assert_eq!((proxy.frames.count(0x50), &served["fast_stop"]), (1, &json!(false)), "{served}");
}
