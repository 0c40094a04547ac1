//! Clients that steer a script on the gripper many times a second.

use std::time::{Duration, Instant};

use serde_json::json;
use tokio::time::{MissedTickBehavior, interval};

use super::{ACCESS_DENIED, FORMAT_ERROR, RANGE_ERROR, SUCCESS, configured, connect};
use crate::harness::wsg::{Driver, floats};
use crate::harness::{Gateway, Scripted, Table, eventually, success};

/// Ids of a streamed script, an ordinary motion script, and a script that only reads.
const STREAM: u8 = 0xB1;
const MOTION: u8 = 0xB0;
const READ: u8 = 0xB2;

/// Usual period of research users.
const EVERY: Duration = Duration::from_millis(20);

const REQUESTS: u32 = 100;

async fn cell() -> (Scripted, Gateway) {
    let scripts = [STREAM, MOTION, READ].map(|id| (id, vec![success(&[id])]));
    let device = Scripted::start(Table::from(scripts)).await;
    let text = format!(
        "[grippers.g]\nurl = \"tcp://{}\"\nread_ids = [{READ}]\nstream_ids = [{STREAM}]\nwsg_port = \"127.0.0.1:0\"\n",
        device.address
    );
    let gateway = configured(&text).await;
    (device, gateway)
}

async fn stream(driver: &mut Driver) {
    let reply = driver.ask(STREAM, &[0xAA; 16]).await;
    assert_eq!((reply.status, reply.data), (SUCCESS, vec![STREAM]));
}

/// Number of streamed requests in the journal, and of records that hold them.
async fn counted(gateway: &Gateway) -> (u64, usize) {
    let events = gateway.events("kind=device&order=oldest&limit=1000", 1).await;
    let streamed: Vec<_> = events.iter().filter(|event| event["event"] == "streamed").collect();
    assert!(streamed.iter().all(|event| event["raw_id"] == STREAM && event["subject"].is_string()), "{streamed:?}");
    (streamed.iter().map(|event| event["count"].as_u64().unwrap()).sum(), streamed.len())
}

#[tokio::test]
async fn stream_keeps_its_rate_with_one_journal_record_a_second() {
    let (device, gateway) = cell().await;
    let mut driver = connect(&gateway).await;
    let mut due = interval(EVERY);
    // Late requests are not caught up.
    due.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut slowest = Vec::new();
    for _ in 0..REQUESTS {
        due.tick().await;
        let asked = Instant::now();
        stream(&mut driver).await;
        slowest.push(asked.elapsed());
    }
    slowest.sort();
    let median = slowest[slowest.len() / 2];
    assert!(median < EVERY, "the stream could not keep its rate: {median:?}");
    assert_eq!(device.frames.count(STREAM), REQUESTS as usize);
    assert_eq!(gateway.state().await["lease_holder"], "wsg:127.0.0.1", "a stream takes the lease like a motion");
    let (count, records) = eventually("all are counted", async || {
        let counted = counted(&gateway).await;
        (counted.0 == u64::from(REQUESTS)).then_some(counted)
    })
    .await;
    assert!(records <= REQUESTS as usize / 10, "{count} in {records} records");
    assert!(gateway.events("kind=command", 0).await.is_empty());
    // A motion right after a stream only has to keep its pause.
    assert_eq!(driver.status(MOTION, &[]).await, SUCCESS);
    stream(&mut driver).await;
    driver.leave().await;
    assert_eq!(gateway.state().await["fast_stop"], false);
}

#[tokio::test]
async fn simultaneous_stream_requests_are_queued() {
    let (_device, gateway) = cell().await;
    let mut driver = connect(&gateway).await;
    for _ in 0..20 {
        driver.send(STREAM, &[]).await;
    }
    for _ in 0..20 {
        assert_eq!(driver.next().await.status, SUCCESS);
    }
}

#[tokio::test]
async fn stream_is_refused_in_fast_stop_and_without_the_lease() {
    let (device, gateway) = cell().await;
    let raw = json!({"id": STREAM, "payload": "00"});
    let answer = gateway.post("raw", &raw).await.ok();
    assert_eq!((&answer["payload"], &answer["outcome"]), (&json!("b1"), &json!("SUCCESS")), "{answer}");

    let lease = gateway.post("lease", &json!({"holder": "other", "ttl_ms": 60_000})).await.ok();
    let sent = device.frames.count(STREAM);
    let mut driver = connect(&gateway).await;
    assert_eq!(driver.status(STREAM, &[]).await, ACCESS_DENIED);
    gateway.post("raw", &raw).await.problem(409, "lease_held");
    assert_eq!(driver.status(READ, &[]).await, SUCCESS, "reads need no lease");
    assert_eq!(device.frames.count(STREAM), sent);
    for _ in 0..50 {
        let streamed = gateway.request("POST", "raw").header("Wsg-Lease", lease["token"].as_str().unwrap()).json(&raw);
        gateway.send(streamed).await.ok();
    }
    assert_eq!(device.frames.count(STREAM), sent + 50);

    gateway.post("fast-stop", &json!({})).await.ok();
    let streamed = gateway.request("POST", "raw").header("Wsg-Lease", lease["token"].as_str().unwrap()).json(&raw);
    gateway.send(streamed).await.problem(409, "fast_stop");
    assert_eq!(driver.status(STREAM, &[]).await, ACCESS_DENIED);
    assert_eq!(device.frames.count(STREAM), sent + 50);
}

#[tokio::test]
async fn client_lost_while_streaming_is_a_fast_stop() {
    let (device, gateway) = cell().await;
    let mut driver = connect(&gateway).await;
    stream(&mut driver).await;
    driver.leave().await;
    eventually("a Stop", async || (device.frames.count(0x22) == 1).then_some(())).await;
    assert_eq!(device.frames.count(0x23), 0);
    let mut driver = connect(&gateway).await;
    stream(&mut driver).await;
    driver.reset();
    gateway.until("the loss is reported", |state| state["fast_stop_cause"] == "client_lost").await;
}

#[tokio::test]
async fn client_lost_after_its_stream_stops_nothing() {
    let (device, gateway) = cell().await;
    let mut driver = connect(&gateway).await;
    stream(&mut driver).await;
    let until = Instant::now() + Duration::from_millis(1200);
    eventually("the stream is over", async || (Instant::now() > until).then_some(())).await;
    driver.reset();
    let state = gateway.until("the lease is free", |state| state["lease_holder"].is_null()).await;
    assert_eq!((&state["fast_stop"], device.frames.count(0x23)), (&json!(false), 0));
}

/// Request of a script in the form of public projects: one byte, width, speed, two gains and two forces.
fn target(width_mm: f32, speed_mm_s: f32) -> Vec<u8> {
    [&[0], floats(&[width_mm, speed_mm_s, 15.0, 0.001, 20.0, 20.0]).as_slice()].concat()
}

/// A controller that pauses and goes on elsewhere makes the fingers jump.
#[tokio::test]
async fn jump_after_a_gap_is_refused_if_configured() {
    let device = Scripted::start(Table::from([(STREAM, vec![success(&[STREAM])])])).await;
    let text = format!(
        "[grippers.g]\nurl = \"tcp://{}\"\nstream_ids = [{STREAM}]\nservo_id = {STREAM}\nservo_adapter = \"position_pd\"\n\
         stream_max_step_mm = 5\nstream_max_speed_mm_s = 150\nwsg_port = \"127.0.0.1:0\"\n",
        device.address
    );
    let gateway = configured(&text).await;
    let width_mm = gateway.state().await["width_mm"].as_f64().unwrap() as f32;
    let mut driver = connect(&gateway).await;
    assert_eq!(driver.status(STREAM, &target(width_mm + 6.0, 100.0)).await, RANGE_ERROR, "the first target");
    for step in [2.0, 4.0, 8.0] {
        assert_eq!(driver.status(STREAM, &target(width_mm - step, 100.0)).await, SUCCESS);
    }
    assert_eq!(driver.status(STREAM, &target(width_mm - 14.0, 100.0)).await, RANGE_ERROR);
    assert_eq!(driver.status(STREAM, &target(width_mm - 8.0, 200.0)).await, RANGE_ERROR);
    assert_eq!(driver.status(STREAM, &[0; 8]).await, FORMAT_ERROR);
    assert_eq!(driver.status(STREAM, &target(width_mm - 9.0, 150.0)).await, SUCCESS);
    assert_eq!(device.frames.count(STREAM), 4);
    let lease = gateway.get("lease").await.ok();
    assert_eq!((&lease["bound"], &lease["expires_in_ms"]), (&json!(true), &json!(3000)), "{lease}");
}
