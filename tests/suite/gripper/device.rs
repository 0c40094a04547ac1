//! Device commands besides motions: settings, statistics, fingers, tare, Loop and raw requests.

use std::time::Duration;

use serde_json::{Value, json};

use crate::harness::wsg::Driver;
use crate::harness::{Gateway, Proxy, Scripted, Simulator, Table, eventually, success};

/// E_INSUFFICIENT_RESOURCES.
const INSUFFICIENT_RESOURCES: u16 = 10;

#[track_caller]
fn assert_has(body: &Value, fields: &Value) {
    for (name, value) in fields.as_object().unwrap() {
        assert_eq!(&body[name], value, "{name} in {body}");
    }
}

#[tokio::test]
async fn settings_are_read_back_from_the_device() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::connected_to(device.address).await;
    let settings = [
        ("acceleration", json!({"acceleration_mm_s2": 2000.0})),
        ("force-limit", json!({"force_n": 30.0})),
        ("soft-limits", json!({"minus_mm": 10.0, "plus_mm": 60.0})),
        ("overdrive", json!({"enabled": true})),
        ("device-tag", json!({"tag": "cell 7"})),
    ];
    for (setting, value) in settings {
        let path = format!("settings/{setting}");
        assert_has(&gateway.put(&path, &value).await.ok(), &value);
        assert_has(&gateway.get(&path).await.ok(), &value);
    }
    let none = json!({"minus_mm": null, "plus_mm": null});
    assert_has(&gateway.delete("settings/soft-limits").await.ok(), &none);
    assert_has(&gateway.get("settings/soft-limits").await.ok(), &none);
    assert_eq!(gateway.get("").await.field("device_tag"), "cell 7");
}

/// Sets the tag, and retries while the write limit refuses it.
async fn set_tag(gateway: &Gateway, tag: &str) {
    let set = async || (gateway.put("settings/device-tag", &json!({"tag": tag})).await.status == 200).then_some(());
    eventually("the tag is set", set).await;
}

#[tokio::test]
async fn device_tag_is_written_once_a_second_by_all_interfaces_together() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let (gateway, port) = Gateway::with_port(proxy.address, &[]).await;
    gateway.until_link("connected").await;
    set_tag(&gateway, "cell 7").await;
    let problem = gateway.put("settings/device-tag", &json!({"tag": "cell 8"})).await.problem(429, "overloaded");
    assert!(problem["detail"].as_str().unwrap().contains("wears the device's flash memory"), "{problem}");
    let raw = json!({"id": 0x51, "payload": hex::encode("cell 9")});
    gateway.post("raw", &raw).await.problem(429, "overloaded");
    let mut driver = Driver::connect(port).await;
    assert_eq!(driver.status(0x51, b"cell 10").await, INSUFFICIENT_RESOURCES);
    assert_eq!(proxy.frames.count(0x51), 1);
    set_tag(&gateway, "cell 8").await;
    assert_eq!(proxy.frames.count(0x51), 2);
    let frames = proxy.frames.all().into_iter().filter(|frame| frame.id == 0x51);
    let times: Vec<_> = frames.map(|frame| frame.at).collect();
    assert!(times[1] - times[0] >= Duration::from_millis(950), "{times:?}");
}

/// The manual of firmware 2 does not demand ASCII, so other programs may have set any tag.
#[tokio::test]
async fn device_tag_of_firmware_2_can_have_other_characters() {
    let device = Simulator::start(&["--firmware", "fw2", "--option", "device_tag=Prüfplatz 3"]).await;
    let gateway = Gateway::connected_to(device.address).await;
    assert_eq!(gateway.get("").await.field("device_tag"), "Prüfplatz 3");
    let set = gateway.put("settings/device-tag", &json!({"tag": "Zelle ü"})).await.ok();
    assert_eq!((&set["tag"], gateway.get("").await.field("device_tag")), (&json!("Zelle ü"), &json!("Zelle ü")));
    gateway.put("settings/device-tag", &json!({"tag": "10 €"})).await.problem(400, "malformed");
    // Not allowed on firmware 4, but shown.
    let device = Simulator::start(&["--option", "device_tag=Prüfplatz 3"]).await;
    let gateway = Gateway::connected_to(device.address).await;
    assert_eq!(gateway.get("").await.field("device_tag"), "Prüfplatz 3");
    assert_eq!(gateway.get("settings/device-tag").await.ok()["tag"], "Prüfplatz 3");
}

#[tokio::test]
async fn unchanged_device_tag_is_not_written_again() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let (gateway, port) = Gateway::with_port(proxy.address, &[]).await;
    gateway.until_link("connected").await;
    set_tag(&gateway, "cell 7").await;
    for _ in 0..20 {
        let set = gateway.put("settings/device-tag", &json!({"tag": "cell 7"})).await.ok();
        assert_eq!(set["tag"], "cell 7");
    }
    let mut driver = Driver::connect(port).await;
    assert_eq!(driver.status(0x51, b"cell 7").await, 0);
    assert_eq!(proxy.frames.count(0x51), 1);
}

#[tokio::test]
async fn out_of_range_setting_is_refused_and_sends_no_frame() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::connected_to(proxy.address).await;
    let before = proxy.frames.len();
    let beyond = [
        ("acceleration", json!({"acceleration_mm_s2": 5001}), "acceleration_mm_s2", 5000.0),
        ("force-limit", json!({"force_n": 81}), "force_n", 80.0),
        ("soft-limits", json!({"minus_mm": 10, "plus_mm": 111}), "plus_mm", 110.0),
        ("soft-limits", json!({"minus_mm": 50, "plus_mm": 40}), "minus_mm", 40.0),
        ("device-tag", json!({"tag": "x".repeat(65)}), "tag", 64.0),
    ];
    for (setting, value, field, max) in beyond {
        let problem = gateway.put(&format!("settings/{setting}"), &value).await.problem(422, "out_of_range");
        assert_eq!((problem["field"].as_str(), problem["max"].as_f64()), (Some(field), Some(max)), "{problem}");
    }
    gateway.put("settings/device-tag", &json!({"tag": "ü"})).await.problem(400, "malformed");
    gateway.put("settings/overdrive", &json!({"enabled": "yes"})).await.problem(400, "malformed");
    let caused: Vec<_> = proxy.frames.since(before).into_iter().filter(|frame| !frame.is_upkeep()).collect();
    assert_eq!(caused, []);
}

#[tokio::test]
async fn soft_limits_bound_the_motions_that_follow() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 400})).await.outcome("SUCCESS");
    gateway.put("settings/soft-limits", &json!({"minus_mm": 30, "plus_mm": 60})).await.ok();
    let beyond = json!({"width_mm": 80, "speed_mm_s": 100});
    let problem = gateway.post("move", &beyond).await.problem(422, "out_of_range");
    assert_eq!((problem["min"].as_f64(), problem["max"].as_f64()), (Some(30.0), Some(60.0)), "{problem}");
    gateway.delete("settings/soft-limits").await.ok();
    gateway.post("move", &beyond).await.outcome("SUCCESS");
}

#[tokio::test]
async fn statistics_count_grips_until_they_are_reset() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    gateway.post("grip", &json!({"width_mm": 20, "speed_mm_s": 400})).await.outcome("NO_PART");
    let counted = json!({"total": 1, "no_part": 1, "lost_part": 0});
    assert_has(&gateway.get("statistics").await.ok(), &counted);
    assert_has(&gateway.post("statistics/reset", &json!({})).await.ok(), &counted);
    assert_has(&gateway.get("statistics").await.ok(), &json!({"total": 0, "no_part": 0, "lost_part": 0}));
}

#[tokio::test]
async fn fingers_without_electronics_can_be_switched_and_have_no_data() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::connected_to(device.address).await;
    for finger in [1, 2] {
        let answer = gateway.get(&format!("fingers/{finger}")).await.ok();
        assert_has(&answer, &json!({"finger": finger, "type_code": 0, "data_bytes": 0}));
        for enabled in [false, true] {
            let switched = gateway.put(&format!("fingers/{finger}/power"), &json!({"enabled": enabled})).await;
            assert_has(&switched.ok(), &json!({"finger": finger, "enabled": enabled}));
        }
        let problem = gateway.get(&format!("fingers/{finger}/data")).await.problem(422, "device_refused");
        assert_eq!(problem["device_status"], "E_NOT_AVAILABLE", "{problem}");
    }
}

#[tokio::test]
async fn finger_with_electronics_reports_type_flags_and_data() {
    let table = Table::from([
        (0x60, vec![success(&[1, 4, 0])]),
        (0x61, vec![success(&[7, 0])]),
        (0x63, vec![success(&[0, 0, 0xA0, 0x41])]),
    ]);
    let device = Scripted::start(table).await;
    let gateway = Gateway::connected_to(device.address).await;
    let answer = gateway.get("fingers/1").await.ok();
    assert_has(&answer, &json!({"type": "WSG-FMF", "type_code": 1, "data_bytes": 4, "flags_raw": 7}));
    assert_has(&answer, &json!({"flags": ["POWER_ON", "CONFIG_AVAIL", "COMM_OPEN"]}));
    assert_has(&gateway.get("fingers/1/data").await.ok(), &json!({"data": "0000a041"}));
}

#[tokio::test]
async fn tare_and_loop_reach_the_device() {
    let device = Scripted::start(Table::from([(0x38, vec![success(&[])])])).await;
    let gateway = Gateway::connected_to(device.address).await;
    assert_has(&gateway.post("tare", &json!({})).await.ok(), &json!({"tared": true}));
    device.answer(0x38, vec![vec![16, 0]]);
    let problem = gateway.post("tare", &json!({})).await.problem(422, "device_refused");
    assert_has(&problem, &json!({"device_status": "E_ACCESS_DENIED", "device_status_code": 16}));

    let data = "aaaaaa06000100".repeat(10);
    assert_has(&gateway.post("loop", &json!({"data": data})).await.ok(), &json!({"data": data}));
    assert_has(&gateway.post("loop", &json!({})).await.ok(), &json!({"data": ""}));
    gateway.post("loop", &json!({"data": "00".repeat(257)})).await.problem(422, "out_of_range");
    gateway.post("loop", &json!({"data": "0"})).await.problem(400, "malformed");
}

#[tokio::test]
async fn raw_request_of_a_known_id_is_checked_like_its_operation() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::connected_to(proxy.address).await;
    let answer = gateway.post("raw", &json!({"id": 0x31})).await.ok();
    assert_has(&answer, &json!({"name": "GetAcceleration", "status": "E_SUCCESS", "payload": "00401c45"}));
    let to_40_mm = format!("00{}{}", hex::encode(40_f32.to_le_bytes()), hex::encode(400_f32.to_le_bytes()));
    let raw = json!({"id": 0x21, "payload": to_40_mm});
    gateway.post("raw", &raw).await.problem(409, "not_referenced");
    assert_eq!(proxy.frames.motions(), 0);
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let moved = gateway.post("raw", &raw).await.ok();
    assert_has(&moved, &json!({"outcome": "SUCCESS", "status_code": 0}));
    let command = moved["command_id"].as_str().unwrap();
    assert_eq!(gateway.command(command).await.outcome("SUCCESS")["kind"], "move");
    let too_wide = format!("00{}{}", hex::encode(5000_f32.to_le_bytes()), hex::encode(100_f32.to_le_bytes()));
    gateway.post("raw", &json!({"id": 0x21, "payload": too_wide})).await.problem(422, "out_of_range");

    let stopped = gateway.post("raw", &json!({"id": 0x23})).await.ok();
    gateway.post("raw", &raw).await.problem(409, "fast_stop");
    gateway.post("acknowledge", &json!({"fast_stop_id": stopped["fast_stop_id"]})).await.ok();
}

#[tokio::test]
async fn raw_requests_reserved_for_the_gateway_are_refused() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::connected_to(proxy.address).await;
    let before = proxy.frames.len();
    for (id, payload, field) in [(0x07, "", "id"), (0x24, "61636b", "id"), (0x40, "010a00", "payload")] {
        let problem = gateway.post("raw", &json!({"id": id, "payload": payload})).await.problem(400, "malformed");
        assert_eq!(problem["field"], field, "{problem}");
    }
    gateway.post("raw", &json!({"id": 0x30, "payload": "00"})).await.problem(400, "malformed");
    gateway.post("raw", &json!({"id": 256})).await.problem(422, "out_of_range");
    let served = gateway.post("raw", &json!({"id": 0x40, "payload": "000000"})).await.ok();
    assert_eq!(served["payload"].as_str().map(str::len), Some(8), "answered from the newest update: {served}");
    let caused: Vec<_> = proxy.frames.since(before).into_iter().filter(|frame| !frame.is_upkeep()).collect();
    assert_eq!(caused, []);
}

#[tokio::test]
async fn custom_id_passes_through_unchanged() {
    let device = Scripted::start(Table::from([(0xB0, vec![success(&[1, 2, 3])])])).await;
    let gateway = Gateway::connected_to(device.address).await;
    let answer = gateway.post("raw", &json!({"id": 0xB0, "payload": "ff00"})).await.ok();
    assert_has(&answer, &json!({"id": 0xB0, "name": null, "status": "E_SUCCESS", "payload": "010203"}));
    let sent = device.frames.all().into_iter().find(|frame| frame.id == 0xB0).map(|frame| frame.payload);
    assert_eq!(sent, Some(vec![0xFF, 0x00]));
    let problem = gateway.post("raw", &json!({"id": 0xB1})).await.problem(422, "device_refused");
    assert_has(&problem, &json!({"device_status": "E_CMD_UNKNOWN", "device_status_code": 14}));
    let written = gateway.events("kind=command&order=oldest", 4).await;
    for (event, (phase, outcome)) in written.iter().zip([
        ("admitted", Value::Null),
        ("done", json!("SUCCESS")),
        ("admitted", Value::Null),
        ("done", json!("REFUSED")),
    ]) {
        assert_eq!((&event["phase"], &event["outcome"]), (&json!(phase), &outcome), "{written:?}");
    }
    assert_eq!((written.len(), &written[1]["command_id"]), (4, &answer["command_id"]), "{written:?}");
}

#[tokio::test]
async fn custom_id_counts_as_a_motion_unless_configured_as_a_read() {
    // B0h starts and never ends.
    let device = Scripted::start(Table::from([(0xB0, vec![vec![0x1A, 0]]), (0xB2, vec![success(&[7])])])).await;
    let toml = format!("[grippers.g]\nurl = \"tcp://{}\"\nread_ids = [0xB2]\n", device.address);
    let gateway = Gateway::with_file(&[], &toml).await;
    gateway.until_link("connected").await;
    let script = json!({"id": 0xB0, "payload": "ff00", "request_id": "job-1"});
    let running = gateway.post("raw?wait_ms=0", &script).await;
    assert_eq!((running.status, running.text("kind").as_str()), (202, "custom"), "{running:?}");
    let id = running.text("id");
    assert_eq!(gateway.post("raw?wait_ms=0", &script).await.field("replayed"), true);
    let refused = gateway.post("home", &json!({})).await.problem(409, "already_running");
    assert_eq!(refused["command"], json!(id));
    let read = gateway.post("raw", &json!({"id": 0xB2})).await.ok();
    assert_has(&read, &json!({"payload": "07", "command_id": null}));

    gateway.post("fast-stop", &json!({})).await.ok();
    gateway.post("raw", &json!({"id": 0xB1})).await.problem(409, "fast_stop");
    let events = gateway.events("kind=command&order=oldest", 1).await;
    let admitted = &events[0];
    assert_has(admitted, &json!({"phase": "admitted", "command": "custom", "raw_id": 0xB0, "payload": "ff00"}));
    assert_eq!(admitted["command_id"], json!(id), "{events:?}");
    assert_eq!(device.frames.count(0xB0), 1);
}
