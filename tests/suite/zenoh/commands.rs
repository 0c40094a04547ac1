//! Commands over Zenoh have the same effects, problems and records as over HTTP.

use std::time::Instant;

use serde_json::{Map, Value, json};

use super::Rig;
use crate::harness::{Gateway, MOTIONS, ZenohClient, eventually, port_for_later};

const FAST_STOP: u8 = 0x23;

/// Returns the journal records of a command, without the members that differ between any two commands.
async fn records(gateway: &Gateway, id: &Value) -> Vec<Map<String, Value>> {
    let both = async || {
        let events = gateway.get("/api/v1/events?kind=command&order=oldest&limit=500").await.ok();
        let events = events["events"].as_array().unwrap().clone();
        let own_events: Vec<_> = events.into_iter().filter(|event| event["command_id"] == *id).collect();
        (own_events.len() == 2).then_some(own_events)
    };
    let events = eventually("two records", both).await;
    let own = ["seq", "at", "command_id", "started_at", "duration_ms"];
    let common = |event: Value| {
        let mut members = event.as_object().unwrap().clone();
        members.retain(|name, _| !own.contains(&name.as_str()));
        members
    };
    events.into_iter().map(common).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn client_of_another_gateway_can_have_the_longest_names() {
    let rig = Rig::start(&[]).await;
    let client = format!("{}/http:2001:db8:1111:2222:3333:4444:5555:6666", "g".repeat(32));
    let lease = rig.client.command(&format!("lease.take?client={client}"), &json!({"ttl_ms": 60000})).await.unwrap();
    assert_eq!(lease["holder"], format!("zenoh:{client}"));
    let fleet = async || rig.gateway.get("/api/v1/fleet").await.ok()["grippers"][0]["lease_holder"].take();
    eventually("the fleet's list has the holder", async || (fleet().await == lease["holder"]).then_some(())).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn command_leaves_the_same_records_as_over_http() {
    let rig = Rig::start(&["--part-mm", "20"]).await;
    rig.gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let open = json!({"width_mm": 60, "speed_mm_s": 400});
    let grip = json!({"width_mm": 20, "speed_mm_s": 200, "force_n": 30, "part_id": "A-1", "request_id": "one"});
    rig.gateway.post("release", &open).await.outcome("SUCCESS");
    let over_http = rig.gateway.post("grip", &grip).await.outcome("PART_HELD");
    rig.gateway.post("release", &open).await.outcome("SUCCESS");
    let over_zenoh = rig.client.command("grip?client=robot-1", &grip).await.unwrap();
    assert_eq!((&over_zenoh["outcome"], &over_zenoh["replayed"]), (&json!("PART_HELD"), &json!(false)));

    let mut http = records(&rig.gateway, &over_http["id"]).await;
    let mut zenoh = records(&rig.gateway, &over_zenoh["id"]).await;
    for (http, zenoh) in http.iter_mut().zip(&mut zenoh) {
        let by = |record: &mut Map<String, Value>| (record.remove("door").unwrap(), record.remove("subject").unwrap());
        assert_eq!(by(http), (json!("http"), json!("http:127.0.0.1")));
        assert_eq!(by(zenoh), (json!("zenoh"), json!("zenoh:robot-1")));
        // Values that the device measured.
        let measured: &[&str] =
            if http["phase"] == "done" { &["width_mm", "force_n", "contact_width_mm"] } else { &[] };
        for &measured in measured {
            let (one, other) = (http.remove(measured), zenoh.remove(measured));
            let difference = one.unwrap().as_f64().unwrap() - other.unwrap().as_f64().unwrap();
            assert!(difference.abs() < 1.0, "{measured}");
        }
    }
    assert_eq!(http, zenoh);

    let again = rig.client.command("grip?client=robot-1", &grip).await.unwrap();
    assert_eq!((&again["id"], &again["replayed"]), (&over_zenoh["id"], &json!(true)));
    let mut other = grip.clone();
    other["width_mm"] = 21.into();
    let refused = rig.client.command("grip?client=robot-1", &other).await.unwrap_err();
    assert_eq!(refused["code"], "request_id_reused");
}

#[tokio::test(flavor = "multi_thread")]
async fn refusals_are_the_same_problems_as_over_http() {
    let rig = Rig::start(&[]).await;
    let before = rig.proxy.frames.len();
    for (command, body) in [
        ("move", json!({"width_mm": 20, "speed_mm_s": 50})),
        ("grip", json!({"width_mm": 5000, "speed_mm_s": 50})),
        ("move", json!({"width_mm": 20})),
        ("move", json!({"width_mm": "20", "speed_mm_s": 50})),
        ("home", json!({"direction": "up"})),
        ("home", json!({"nonsense": 1})),
        ("home", json!([])),
        ("acknowledge", json!({"fast_stop_id": "none"})),
        ("move", json!({"width_mm": 20, "speed_mm_s": 50, "lease": "stale"})),
    ] {
        let over_zenoh = rig.client.command(command, &body).await.unwrap_err();
        assert_eq!(over_zenoh, rig.gateway.post(command, &body).await.body, "{command} {body}");
    }
    for bytes in [70_000, 2 * 1024 * 1024] {
        let mut long = rig.client.all("wsg/v1/gateway/g/command/home", "x".repeat(bytes)).await;
        let long = long.remove(0).1.unwrap_err();
        assert_eq!((&long["code"], &long["value"], &long["max"]), (&json!("too_large"), &json!(bytes), &json!(65536)));
    }
    let mut refused = rig.client.all("wsg/v1/gateway/g/command/home", "{\"direction\"").await;
    assert_eq!(refused.remove(0).1.unwrap_err()["code"], "malformed");
    let waits = rig.client.command("home?wait_ms=60001", &json!({})).await.unwrap_err();
    assert_eq!((&waits["code"], &waits["field"]), (&json!("out_of_range"), &json!("wait_ms")));
    let unseen = rig.client.command("lease.take", &json!({"holder": "ro\u{200B}bot"})).await.unwrap_err();
    assert_eq!((&unseen["code"], &unseen["field"]), (&json!("malformed"), &json!("holder")), "{unseen}");
    let unseen = rig.client.command("home?client=ro%E2%80%8Bbot", &json!({})).await.unwrap_err();
    assert_eq!((&unseen["code"], &unseen["field"]), (&json!("malformed"), &json!("client")), "{unseen}");
    assert_eq!(rig.client.command("leap", &json!({})).await.unwrap_err()["code"], "not_found");
    assert_eq!(rig.client.command("home", &json!({"gripper": "h"})).await.unwrap_err()["field"], "gripper");
    assert!(rig.proxy.frames.since(before).iter().all(|frame| !MOTIONS.contains(&frame.id)), "no motion is sent");
}

#[tokio::test(flavor = "multi_thread")]
async fn wildcard_query_moves_no_gripper() {
    let rig = Rig::start(&[]).await;
    let before = rig.proxy.frames.len();
    for key in ["wsg/v1/*/*/command/home", "wsg/v1/gateway/*/command/home", "wsg/v1/gateway/g/command/*", "wsg/v1/**"] {
        for (_, answer) in rig.client.all(key, "").await {
            let Err(problem) = answer else { continue };
            assert_eq!((&problem["code"], &problem["field"]), (&json!("malformed"), &json!("key")), "{problem}");
        }
    }
    assert!(rig.proxy.frames.since(before).iter().all(|frame| !MOTIONS.contains(&frame.id)), "no motion is sent");
    let begun = rig.client.command("home?wait_ms=0", &json!({})).await.unwrap();
    assert_eq!(begun["phase"], "running");
    let command = json!({"command": begun["id"]});
    let ended = rig.client.command("command?wait_ms=20000", &command).await.unwrap();
    assert_eq!((&ended["phase"], &ended["outcome"]), (&json!("done"), &json!("SUCCESS")));
    let stopped = rig.client.command("stop?wait_ms=soon", &json!({"gripper": "other"})).await.unwrap();
    assert_eq!(stopped["kind"], "stop");
    let stopped = rig.client.all("wsg/v1/*/*/command/fast-stop", "not JSON").await;
    assert_eq!(stopped[0].1.as_ref().unwrap()["fast_stop_confirmed"], true);
}

#[tokio::test(flavor = "multi_thread")]
async fn put_with_any_payload_stops_one_gateway_or_all() {
    let rig = Rig::start(&[]).await;
    rig.gateway.post("home", &json!({"direction": "outer"})).await.outcome("SUCCESS");
    for (key, payload, reason) in [
        ("wsg/v1/gateway/fast-stop", &b"{\"reason\": \"light curtain\"}"[..], "light curtain"),
        ("wsg/v1/fast-stop", b"door open", "door open"),
        ("wsg/v1/fast-stop", b"", ""),
        ("wsg/v1/gateway/fast-stop", b"\xFF{]", "\u{FFFD}{]"),
    ] {
        rig.gateway.begin("move", &json!({"width_mm": 5, "speed_mm_s": 5})).await;
        rig.gateway.until_moving().await;
        let put = Instant::now();
        rig.client.put(key, payload).await;
        eventually("23h", async || rig.proxy.frames.first_since(FAST_STOP, put)).await;
        let state = rig.gateway.until("the FAST STOP is confirmed", |state| state["fast_stop_confirmed"] == true).await;
        assert_eq!((&state["fast_stop_reason"], &state["fast_stop_by"]), (&json!(reason), &json!("zenoh:unknown")));
        let acknowledge = json!({"fast_stop_id": state["fast_stop_id"]});
        let acknowledged = rig.client.command("acknowledge", &acknowledge).await.unwrap();
        assert_eq!(acknowledged["fast_stop"], false);
        rig.gateway.post("home", &json!({"direction": "outer"})).await.outcome("SUCCESS");
    }
    rig.client.put("wsg/v1/another/fast-stop", "not this one").await;
    // As for clearing the storages of a network.
    rig.client.session.delete("wsg/**").await.unwrap();
    let deletes = "wsg_requests_total{door=\"zenoh\",method=\"DELETE\",route=\"fast-stop\",status=\"405\"}";
    eventually("ignored deletes", async || (rig.gateway.figures().await.get(deletes) == Some(&2.0)).then_some(()))
        .await;
    let state = rig.client.ask("wsg/v1/gateway/g/state", &Value::Null).await.unwrap();
    assert_eq!(state["fast_stop"], false);
}

/// Returns readiness, the Zenoh cause, and the `wsg_zenoh_up` metric.
pub async fn readiness(gateway: &Gateway) -> (Value, String, f64) {
    let ready = gateway.get("/readyz").await.body;
    let up = gateway.figures().await["wsg_zenoh_up"];
    (ready["ready"].clone(), ready["zenoh_cause"].as_str().unwrap_or_default().to_owned(), up)
}

#[tokio::test(flavor = "multi_thread")]
async fn occupied_port_is_reported_and_retried() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", taken.local_addr().unwrap());
    let gateway = Gateway::start(&["--gripper", "g=sim://wsg50", "--zenoh-listen", &endpoint]).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let cause = eventually("the occupied port is reported", async || {
        let (ready, cause, up) = readiness(&gateway).await;
        assert_eq!((ready, up), (json!(false), 0.0));
        cause.contains(&endpoint).then_some(cause)
    })
    .await;
    assert!(cause.contains("stop the program that listens there") && cause.contains("--zenoh-listen"), "{cause}");
    gateway.until_logged(&cause).await;
    drop(taken);
    eventually("the gateway is ready", async || {
        (readiness(&gateway).await == (json!(true), String::new(), 1.0)).then_some(())
    })
    .await;
    assert_eq!(gateway.word_after("Zenoh: ").await, endpoint);
    let client = ZenohClient::of(&gateway).await;
    assert_eq!(client.command("stop", &json!({})).await.unwrap()["outcome"], "SUCCESS");
    assert!(gateway.terminate().await.status.success());
}

/// Zenoh lists no address for this endpoint, as for 0.0.0.0 while no network is connected.
#[tokio::test(flavor = "multi_thread")]
async fn gateway_without_a_network_is_ready() {
    let port = port_for_later();
    let endpoint = format!("tcp/0.0.0.0:{port}#iface=lo");
    let gateway = Gateway::start(&["--gripper", "g=sim://wsg50", "--zenoh-listen", &endpoint, "--insecure"]).await;
    eventually("the gateway is ready", async || (readiness(&gateway).await.0 == true).then_some(())).await;
    let client = ZenohClient::at(&format!("tcp/127.0.0.1:{port}")).await;
    assert_eq!(client.command("stop", &json!({})).await.unwrap()["outcome"], "SUCCESS");
}

#[tokio::test(flavor = "multi_thread")]
async fn missing_router_delays_neither_commands_nor_shutdown() {
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    // The listener accepts connections, and stays silent.
    let endpoint = format!("tcp/{}", nobody.local_addr().unwrap());
    let zenoh = ["--zenoh-mode", "client", "--zenoh-connect", &endpoint];
    let gateway = Gateway::start(&[&["--gripper", "g=sim://wsg50"], &zenoh[..]].concat()).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    assert_eq!(gateway.get("/api/v1/fleet").await.ok()["grippers"].as_array().unwrap().len(), 1);
    let stopped = gateway.post("/api/v1/fleet/fast-stop", &json!({})).await.ok();
    assert_eq!(stopped["confirmed"], json!(["gateway/g"]));
    assert_eq!(stopped["fast_stop_confirmed"], false, "other gateways may be out of reach");
    eventually("the missing router is reported", async || {
        let (_, cause, _) = readiness(&gateway).await;
        cause.contains(&format!("not connected to {endpoint}")).then_some(())
    })
    .await;
    let ended = gateway.terminate().await;
    assert!(ended.status.success(), "{}", ended.stderr);
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_are_counted_by_interface() {
    let rig = Rig::start(&[]).await;
    rig.client.command("home", &json!({})).await.unwrap();
    rig.client.command("grip", &json!({})).await.unwrap_err();
    let token = rig.client.live(&ZenohClient::of(&rig.gateway).await, "wsg/v1/gateway/client/robot").await;
    let figures = rig.gateway.figures().await;
    let of = |rest: &str| figures.get(&format!("wsg_{rest}")).copied();
    let counted = |route: &str, status: u16| {
        of(&format!("requests_total{{door=\"zenoh\",method=\"QUERY\",route=\"{route}\",status=\"{status}\"}}"))
    };
    assert_eq!((counted("home", 200), counted("grip", 400)), (Some(1.0), Some(1.0)));
    eventually("the client is counted", async || {
        let figures = rig.gateway.figures().await;
        (figures.get("wsg_clients_connected{door=\"zenoh\"}").copied() == Some(1.0)).then_some(())
    })
    .await;
    drop(token);
}
