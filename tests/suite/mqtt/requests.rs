//! Requests and FAST STOPs over MQTT.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::broker::{ANSWERS, Broker, Got, Request};
use super::homed;
use crate::harness::eventually;

const BOTH: &str = "commands = true\nfast_stop = true";
const FAST_STOP: &str = "plant/cell/g/fast-stop";

#[tokio::test]
async fn commands_are_off_by_default() {
    let broker = Broker::start().await;
    let gateway = homed(&broker, &[], "").await;
    broker.until("plant/cell/availability", |_| true).await;
    let connected = gateway.figures().await;
    let connections = connected.keys().filter(|name| name.starts_with("wsg_mqtt_connected")).count();
    assert_eq!((connections, broker.connects()), (1, 1));
}

#[tokio::test]
async fn requests_are_answered_with_correlation_data() {
    let broker = Broker::start().await;
    let gateway = homed(&broker, &[], BOTH).await;
    broker.until_subscribed("plant/cell/g/command/grip").await;
    let request = Request {
        topic: "plant/cell/g/command/grip",
        payload: "{\"width_mm\": 20, \"speed_mm_s\": 200, \"part_id\": \"housing-7\"}",
        correlation: Some("job-7"),
        properties: &[("request_id", "job-7"), ("wait_ms", "20000"), ("client", "mes")],
        is_retained: false,
    };
    broker.send(&request);
    let answer = broker.answer("job-7").await;
    assert_eq!(
        (answer.property("status"), answer.properties.content_type.as_deref()),
        (Some("200"), Some("application/json"))
    );
    let first = answer.json();
    assert_eq!(first["outcome"], "PART_HELD");
    let event = &gateway.events("kind=command", 1).await[0];
    assert_eq!((&event["door"], &event["subject"]), (&json!("mqtt"), &json!("mqtt:mes")));

    // A repeated request with the same request id is the same command.
    broker.send(&Request { correlation: Some("job-7b"), ..request });
    assert_eq!(broker.answer("job-7b").await.json()["id"], first["id"]);
    let state = broker.ask("plant/cell/g/command/state", "").await.json();
    assert_eq!((&state["gripper"], &state["state"]), (&json!("g"), &json!("HOLDING")));
    let grippers = broker.ask("plant/cell/command/grippers", "").await.json();
    assert_eq!(grippers["grippers"][0]["gripper"], "g");
}

#[tokio::test]
async fn refusals_are_problems() {
    let broker = Broker::start().await;
    let gateway = homed(&broker, &[], BOTH).await;
    broker.until_subscribed("plant/cell/g/command/grip").await;
    for (topic, payload, status, code) in [
        ("plant/cell/g/command/grip", "{\"width_mm\": 500, \"speed_mm_s\": 200}", "422", "out_of_range"),
        ("plant/cell/g/command/grip", "{\"width_mm\": 20", "400", "malformed"),
        (
            "plant/cell/g/command/grip",
            "{\"width_mm\": 20, \"speed_mm_s\": 200, \"gripper\": \"h\"}",
            "400",
            "malformed",
        ),
        ("plant/cell/h/command/grip", "{\"width_mm\": 20, \"speed_mm_s\": 200}", "404", "not_found"),
        ("plant/cell/g/command/grasp", "{}", "404", "not_found"),
        ("plant/cell/command/grip", "{}", "404", "not_found"),
        ("plant/cell/g/command/lease.take", "{\"holder\": \"mes\"}", "405", "method_not_allowed"),
    ] {
        let answer = broker.ask(topic, payload).await;
        let problem = answer.json();
        assert_eq!(
            (answer.property("status"), problem["code"].as_str()),
            (Some(status), Some(code)),
            "{topic} {problem}"
        );
        assert_eq!(answer.properties.content_type.as_deref(), Some("application/problem+json"));
    }
    let lease = gateway.post("lease", &json!({"holder": "robot", "ttl_ms": 60_000})).await;
    assert_eq!(lease.status, 200, "{lease:?}");
    let refused = broker.ask("plant/cell/g/command/move", "{\"width_mm\": 50, \"speed_mm_s\": 200}").await;
    assert_eq!(refused.json()["code"], "lease_held", "{refused:?}");
    let token = lease.text("token");
    let correlation = Some("with lease");
    let payload = "{\"width_mm\": 50, \"speed_mm_s\": 200}";
    let properties: &[(&str, &str)] = &[("lease", &token), ("wait_ms", "20000")];
    broker.send(&Request {
        topic: "plant/cell/g/command/move",
        payload,
        correlation,
        properties,
        ..Request::default()
    });
    assert_eq!(broker.answer("with lease").await.json()["outcome"], "SUCCESS");
}

#[tokio::test]
async fn retained_commands_are_refused_and_told() {
    let broker = Broker::start().await;
    broker.retain("plant/cell/g/command/move", "{\"width_mm\": 50, \"speed_mm_s\": 200}");
    broker.retain(FAST_STOP, "{}");
    let gateway = homed(&broker, &[], BOTH).await;
    eventually("two refusals", async || (broker.all(ANSWERS).len() >= 2).then_some(())).await;
    assert!(broker.all(ANSWERS).iter().all(|answer| answer.json()["field"] == "retain"));
    broker.until_subscribed("plant/cell/g/command/move").await;
    broker.send(&Request {
        topic: "plant/cell/g/command/move",
        payload: "{\"width_mm\": 50, \"speed_mm_s\": 200}",
        correlation: Some("live"),
        is_retained: true,
        ..Request::default()
    });
    assert_eq!(broker.answer("live").await.json()["field"], "retain");
    let state = gateway.get("state").await.ok();
    assert_eq!((&state["fast_stop"], &state["last_command"]), (&json!(false), &json!(1)), "only the homing has moved");
    let refused = gateway.events("kind=refused", 1).await;
    assert_eq!((&refused[0]["door"], &refused[0]["command"]), (&json!("mqtt"), &json!("move")));
    let ended = gateway.terminate().await;
    assert!(ended.stderr.contains("it is retained"), "{}", ended.stderr);
}

#[tokio::test]
async fn fast_stop_works_with_commands_off_and_a_repetition_stops_once() {
    let broker = Broker::start().await;
    let gateway = homed(&broker, &[], "fast_stop = true\nrole = \"stop\"").await;
    broker.until_subscribed(FAST_STOP).await;
    let request = Request {
        topic: FAST_STOP,
        payload: "{\"reason\": \"light curtain\"}",
        correlation: Some("stop-1"),
        properties: &[("client", "plc7")],
        is_retained: false,
    };
    broker.send(&request);
    let first = broker.answer("stop-1").await.json();
    assert_eq!(first["fast_stop_confirmed"], true);
    let state = gateway.get("state").await.ok();
    assert_eq!((&state["fast_stop_by"], &state["fast_stop_reason"]), (&json!("mqtt:plc7"), &json!("light curtain")));
    broker.send(&request);
    let answers = eventually("a second answer", async || {
        let answers = broker.all(ANSWERS);
        (answers.len() == 2).then_some(answers)
    })
    .await;
    assert_eq!(answers[1].json()["fast_stop_id"], first["fast_stop_id"]);
    // One latch, which its confirmation follows.
    let latched = gateway.events("kind=fast_stop", 2).await;
    assert_eq!(latched.iter().filter(|event| event["event"] == "latched").count(), 1, "{latched:?}");

    // After the acknowledgement, the same message stops again.
    gateway.post("acknowledge", &json!({"fast_stop_id": first["fast_stop_id"]})).await.ok();
    broker.send(&request);
    let third = eventually("a third answer", async || broker.all(ANSWERS).get(2).map(Got::json)).await;
    assert_ne!(third["fast_stop_id"], first["fast_stop_id"]);
    assert_eq!(gateway.get("state").await.ok()["fast_stop_id"], third["fast_stop_id"]);
}

#[tokio::test]
async fn any_message_to_the_topic_of_fast_stops_stops() {
    let broker = Broker::start().await;
    let gateway = homed(&broker, &[], BOTH).await;
    broker.until_subscribed("plant/cell/fast-stop").await;
    broker.until_subscribed("plant/cell/command/fast-stop").await;
    let topics = [
        "plant/cell/fast-stop",
        "plant/cell/x/fast-stop",
        "plant/cell/g/command/fast-stop",
        "plant/cell/command/fast-stop",
    ];
    for (topic, payload) in topics.iter().zip(["", "not JSON", "[1]", "{\"gripper\": 7}"]) {
        broker.send(&Request { topic, payload, ..Request::default() });
        let id = eventually(topic, async || {
            let state = gateway.get("state").await.ok();
            (state["fast_stop_confirmed"] == true).then(|| state["fast_stop_id"].clone())
        })
        .await;
        gateway.post("acknowledge", &json!({"fast_stop_id": id})).await.ok();
        eventually("no FAST STOP", async || (gateway.get("state").await.ok()["fast_stop"] == false).then_some(()))
            .await;
    }
}

#[tokio::test]
async fn role_limits_all_clients() {
    let broker = Broker::start().await;
    let gateway = homed(&broker, &[], "commands = true\nrole = \"observer\"").await;
    broker.until_subscribed("plant/cell/g/command/move").await;
    let refused = broker.ask("plant/cell/g/command/move", "{\"width_mm\": 50, \"speed_mm_s\": 200}").await;
    assert_eq!((refused.property("status"), refused.json()["code"].as_str()), (Some("403"), Some("forbidden")));
    assert_eq!(broker.ask("plant/cell/g/command/state", "").await.json()["gripper"], "g");
    let state: Value = gateway.get("state").await.ok();
    assert_eq!(state["last_command"], 1);
}

#[tokio::test]
async fn flood_of_requests_delays_no_fast_stop() {
    let broker = Broker::start().await;
    let gateway = homed(&broker, &[], BOTH).await;
    broker.until_subscribed("plant/cell/g/command/state").await;
    broker.until_subscribed(FAST_STOP).await;
    broker.flood("plant/cell/g/command/move", "{\"width_mm\": 50, \"speed_mm_s\": 200}", 9000);
    let begin = Instant::now();
    broker.send(&Request { topic: FAST_STOP, correlation: Some("stop"), ..Request::default() });
    assert_eq!(broker.answer("stop").await.json()["fast_stop_confirmed"], true);
    let took = begin.elapsed();
    assert!(took < Duration::from_secs(1), "{took:?}");
    let overloaded = eventually("answers to the flood", async || {
        let answers = broker.all(ANSWERS);
        (answers.len() > 1000).then_some(answers)
    })
    .await;
    assert!(overloaded.iter().any(|answer| answer.json()["code"] == "overloaded"));
    drop(gateway);
}
