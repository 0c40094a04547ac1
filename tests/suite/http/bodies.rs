//! Invalid request bodies: each is a clear problem, never a 5xx and never a frame.

use serde_json::{Value, json};

use crate::harness::{Gateway, Proxy, Simulator};

/// Expected answer: status, code, field, and limits (minimum, maximum).
type Expected = (u16, &'static str, Option<&'static str>, Option<(f64, f64)>);

const fn malformed(field: &'static str) -> Expected {
    (400, "malformed", Some(field), None)
}

const fn out_of_range(field: &'static str, min: f64, max: f64) -> Expected {
    (422, "out_of_range", Some(field), Some((min, max)))
}

const NOT_JSON: Expected = (400, "malformed", None, None);

const GRIPS: &[(&str, Expected)] = &[
    (r#"{"width_mm": 5000, "speed_mm_s": 50}"#, out_of_range("width_mm", 0.0, 110.0)),
    (r#"{"width_mm": 110.5, "speed_mm_s": 50}"#, out_of_range("width_mm", 0.0, 110.0)),
    (r#"{"width_mm": -0.5, "speed_mm_s": 50}"#, out_of_range("width_mm", 0.0, 110.0)),
    (r#"{"width_mm": 1e30, "speed_mm_s": 50}"#, out_of_range("width_mm", 0.0, 110.0)),
    (r#"{"width_mm": 20, "speed_mm_s": 0}"#, out_of_range("speed_mm_s", 5.0, 420.0)),
    (r#"{"width_mm": 20, "speed_mm_s": 421}"#, out_of_range("speed_mm_s", 5.0, 420.0)),
    (r#"{"width_mm": 20, "speed_mm_s": 50, "force_n": 81}"#, out_of_range("force_n", 5.0, 80.0)),
    (r#"{"width_mm": "20", "speed_mm_s": 50}"#, malformed("width_mm")),
    (r#"{"width_mm": null, "speed_mm_s": 50}"#, malformed("width_mm")),
    (r#"{"width_mm": {}, "speed_mm_s": 50}"#, malformed("width_mm")),
    (r#"{"width_mm": 20, "speed_mm_s": true}"#, malformed("speed_mm_s")),
    (r#"{"width_mm": 20}"#, malformed("speed_mm_s")),
    (r#"{"width_mm": 20, "width_mm": 20, "speed_mm_s": 50}"#, malformed("width_mm")),
    (r#"{"width_mm": 20, "speed_mm_s": 50, "speed": 50}"#, malformed("speed")),
    (r#"{"width_mm": 20, "speed_mm_s": 50, "part_id": "a\nb"}"#, malformed("part_id")),
    (r#"{"width_mm": 20, "speed_mm_s": 50, "part_id": true}"#, malformed("part_id")),
    ("", malformed("width_mm")),
    ("{}", malformed("width_mm")),
    (r#"{"width_mm": NaN, "speed_mm_s": 50}"#, (400, "malformed", Some("width_mm"), None)),
    (r#"{"width_mm": 1e999, "speed_mm_s": 50}"#, (400, "malformed", Some("width_mm"), None)),
    (r#"{"width_mm": 20, "speed_mm_s": 50"#, NOT_JSON),
    (r#"{"width_mm": 20, "speed_mm_s": 50}}"#, NOT_JSON),
    ("[]", NOT_JSON),
    ("[20, 50, null, null]", NOT_JSON),
    ("null", NOT_JSON),
    ("\"grip\"", NOT_JSON),
    ("width_mm=20&speed_mm_s=50", NOT_JSON),
];

fn check(body: &str, problem: &Value, (_, _, field, limits): Expected) {
    if let Some(field) = field {
        assert_eq!(problem["field"], field, "{body}: {problem}");
    }
    if let Some((min, max)) = limits {
        assert_eq!((problem["min"].as_f64(), problem["max"].as_f64()), (Some(min), Some(max)), "{body}: {problem}");
    }
    assert!(!problem["detail"].as_str().unwrap().is_empty(), "{body}: {problem}");
}

#[tokio::test]
async fn invalid_grip_names_field_and_limits_and_sends_no_frame() {
    let device = Simulator::with_part().await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let before = proxy.frames.len();
    for &(body, expected) in GRIPS {
        let answer = gateway.send(gateway.request("POST", "grip").body(body)).await;
        assert_eq!(answer.status, expected.0, "{body}: {}", answer.body);
        check(body, &answer.problem(expected.0, expected.1), expected);
    }
    let not_text = gateway.request("POST", "grip").body(&b"{\"width_mm\": 20, \"part_id\": \"\xFF\xFE\"}"[..]);
    gateway.send(not_text).await.problem(400, "malformed");
    let large = gateway.request("POST", "grip").body(vec![b' '; 1 << 20]);
    let problem = gateway.send(large).await.problem(413, "too_large");
    assert_eq!(problem["max"], 65536, "{problem}");
    let long = json!({"width_mm": 20, "speed_mm_s": 50, "part_id": "x".repeat(49)});
    let problem = gateway.post("grip", &long).await.problem(422, "out_of_range");
    assert_eq!((&problem["field"], &problem["max"]), (&json!("part_id"), &json!(48)), "{problem}");

    let caused: Vec<_> = proxy.frames.since(before).into_iter().filter(|frame| !frame.is_upkeep()).collect();
    assert_eq!(caused, []);
    let grip = json!({"width_mm": 20, "speed_mm_s": 100});
    gateway.post("grip", &grip).await.outcome("PART_HELD");
}

#[tokio::test]
async fn refusal_does_not_repeat_a_long_text() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::connected_to(device.address).await;
    let long = "\u{fc}".repeat(30_000);
    let recipe = json!({"number": 1, "grippers": {&long: {"width_mm": 20}}});
    for (method, path, body) in [
        ("PUT", "/api/v1/recipes/A-1", recipe),
        ("POST", "/api/v1/alarms/acknowledge", json!({"ids": [long]})),
        ("POST", "/api/v1/fleet/copy-recipes", json!({"gateway": long})),
        ("POST", "grip", json!({"width_mm": format!("expected {long}"), "speed_mm_s": 50})),
    ] {
        let problem = gateway.send(gateway.request(method, path).json(&body)).await.problem(400, "malformed");
        assert!(problem.to_string().len() < 2500, "{path}: {} bytes", problem.to_string().len());
    }
}

#[tokio::test]
async fn unknown_path_method_or_query_is_a_problem() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::connected_to(device.address).await;
    gateway.get("/api/v1/grippers/nobody/state").await.problem(404, "not_found");
    gateway.get("/api/v1/nothing").await.problem(404, "not_found");
    gateway.get("fingers/3").await.problem(404, "not_found");
    gateway.get("commands/7").await.problem(404, "not_found");
    gateway.delete("state").await.problem(405, "method_not_allowed");
    gateway.post("home?wait_ms=soon", &json!({})).await.problem(400, "malformed");
    let problem = gateway.post("home?wait_ms=60001", &json!({})).await.problem(422, "out_of_range");
    assert_eq!((&problem["field"], &problem["max"]), (&json!("wait_ms"), &json!(60000.0)), "{problem}");
    let state = gateway.state().await;
    assert_eq!(state["referenced"], false, "the gripper is not homed: {state}");
}
