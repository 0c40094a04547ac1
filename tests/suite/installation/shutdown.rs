//! End of a gateway: orderly with an announcement, or abrupt with a FAST STOP by the device.

use serde_json::{Value, json};
use wsg_gateway::journal::{EventKind, EventQuery, Filter, GripQuery, Reader};

use crate::harness::{Frame, Gateway, JournalFile, Proxy, Simulator};

fn ids(frames: &[Frame]) -> Vec<u8> {
    frames.iter().map(|frame| frame.id).collect()
}

async fn assert_no_fast_stop(device: &Simulator) {
    let next = Gateway::connected_to(device.address).await;
    let state = next.state().await;
    assert_eq!(state["fast_stop"], false, "{state}");
}

#[tokio::test]
async fn sigterm_announces_the_disconnect_once_last_and_leaves_no_fast_stop() {
    let device = Simulator::with_part().await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    gateway.post("grip", &json!({"width_mm": 20, "speed_mm_s": 200})).await.outcome("PART_HELD");
    let ended = gateway.terminate().await;
    assert!(ended.status.success(), "{ended:?}");
    let ids = ids(&proxy.frames.all());
    assert_eq!(ids.last(), Some(&0x07));
    assert_eq!(proxy.frames.count(0x07), 1);
    assert!(!ids.contains(&0x23) && !ids.contains(&0x24) && !ids.contains(&0x22), "{ids:x?}");
    assert_no_fast_stop(&device).await;
}

#[tokio::test]
async fn simulated_device_exits_cleanly_on_sigterm() {
    for is_connected in [false, true] {
        let device = Simulator::start(&[]).await;
        let gateway = Gateway::of(device.address).await;
        if is_connected {
            gateway.until_link("connected").await;
        }
        let ended = device.terminate().await;
        assert!(ended.status.success(), "{ended:?}");
    }
}

#[tokio::test]
async fn sigterm_lets_a_short_motion_finish() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    gateway.begin("move", &json!({"width_mm": 80, "speed_mm_s": 50})).await;
    gateway.until_moving().await;
    assert!(gateway.terminate().await.status.success());
    assert_eq!(proxy.frames.count(0x22), 0, "the motion was not stopped");
    assert_eq!(proxy.frames.all().last().map(|frame| frame.id), Some(0x07));
    assert_no_fast_stop(&device).await;
}

#[tokio::test]
async fn sigterm_stops_a_long_motion_before_the_announcement() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    gateway.begin("move", &json!({"width_mm": 10, "speed_mm_s": 5})).await;
    gateway.until_moving().await;
    assert!(gateway.terminate().await.status.success());
    let ids = ids(&proxy.frames.all());
    assert!(ids.ends_with(&[0x22, 0x07]), "{ids:x?}");
    assert_no_fast_stop(&device).await;
}

#[tokio::test]
async fn sigterm_without_a_device_ends_at_once() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::of(Proxy::refusing(device.address).address).await;
    assert!(gateway.terminate().await.status.success());
}

#[tokio::test]
async fn next_gateway_after_sigkill_reports_the_fast_stop() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    gateway.begin("move", &json!({"width_mm": 10, "speed_mm_s": 5})).await;
    gateway.until_moving().await;
    gateway.kill().await;

    let proxy = Proxy::to(device.address);
    let next = Gateway::connected_to(proxy.address).await;
    let state = next.until("the FAST STOP is reported", |state| state["fast_stop"] == true).await;
    assert!(matches!(state["fast_stop_cause"].as_str(), Some("unknown" | "unannounced_disconnect")), "{state}");
    assert_eq!((&state["fast_stop_by"], &state["moving"]), (&json!("device"), &json!(false)), "{state}");
    let id = &state["fast_stop_id"];
    let refused = next.post("move", &json!({"width_mm": 40, "speed_mm_s": 100})).await.problem(409, "fast_stop");
    assert_eq!(&refused["fast_stop_id"], id);
    assert_eq!((proxy.frames.motions(), proxy.frames.count(0x24)), (0, 0), "unasked: {:?}", proxy.frames.all());

    next.post("acknowledge", &json!({"fast_stop_id": id})).await.ok();
    next.post("move", &json!({"width_mm": 40, "speed_mm_s": 100})).await.outcome("SUCCESS");
    assert_eq!((proxy.frames.motions(), proxy.frames.count(0x24)), (1, 1));
}

#[tokio::test]
async fn last_events_before_the_exit_are_in_the_journal() {
    let journal = JournalFile::new();
    let arguments = ["--gripper", "g=sim://wsg50?part_mm=20", "--journal", &journal.path()];
    let gateway = Gateway::start(&arguments).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    for _ in 0..5 {
        gateway.post("move", &json!({"width_mm": 1000, "speed_mm_s": 50})).await.problem(422, "out_of_range");
    }
    gateway.post("grip", &json!({"width_mm": 20, "speed_mm_s": 200})).await.outcome("PART_HELD");
    assert!(gateway.terminate().await.status.success());
    let reader = Reader::open(journal.path().as_ref()).unwrap();
    let filter = Filter { kind: Some(EventKind::Refused), ..Filter::default() };
    let refused = reader.events(&EventQuery { filter, ..EventQuery::default() }).unwrap();
    let count = |body: &str| serde_json::from_str::<Value>(body).unwrap()["count"].as_u64().unwrap();
    assert_eq!(refused.bodies.iter().map(|body| count(body)).sum::<u64>(), 5, "{refused:?}");
    let grips = reader.grips(&GripQuery::default()).unwrap();
    assert!(grips.bodies[0].contains("\"kind\":\"grip\""), "{grips:?}");
}
