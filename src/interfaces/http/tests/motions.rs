//! Motions and commands, through the router.

use serde_json::json;

use super::*;
use crate::gripper::{Conflict, DeviceRefusal, Invalid};
use crate::model::{CommandId, Motion, Outcome};
use crate::wsg::{Speed, Status, Width};

#[tokio::test]
async fn ended_command_is_200_with_its_outcome() {
    let mut gateway = with_fate(Fate::Ends(Outcome::NoPart));
    let body = json!({"width_mm": 20, "speed_mm_s": 50.5, "force_n": 40, "part_id": "A-1", "request_id": "7"});
    let answer = gateway.left("POST", "grip", body).await;
    assert_eq!((answer.status, &answer.body["outcome"]), (200, &"NO_PART".into()));
    assert_eq!(answer.body["client"], "http:unknown");
    let Seen::Submission(submission) = gateway.seen.recv().await.unwrap() else { panic!() };
    assert_eq!(submission.request_id.unwrap().as_str(), "7");
    let Action::Motion(Motion::Grip { width, speed, force, part_id, .. }) = submission.action else { panic!() };
    assert_eq!((width.mm(), speed.mm_s(), force.unwrap().n()), (20.0, 50.5, 40.0));
    assert_eq!(part_id.unwrap().as_str(), "A-1");
}

#[tokio::test]
async fn running_command_is_202_and_can_be_cancelled() {
    let gateway = with_fate(Fate::Runs);
    let answer = gateway.left("POST", "home?wait_ms=0", json!({})).await;
    assert_eq!((answer.status, &answer.body["phase"]), (202, &"running".into()));
    let location = answer.headers[header::LOCATION].to_str().unwrap().to_owned();
    assert_eq!(location, format!("/api/v1/grippers/left/commands/{}", answer.body["id"].as_str().unwrap()));
    let found = gateway.ask("GET", &location, "").await;
    assert_eq!((found.status, &found.body["phase"]), (200, &"running".into()));
    let cancelled = gateway.ask("POST", &format!("{location}/cancel"), "").await;
    assert_eq!((cancelled.status, &cancelled.body["outcome"]), (200, &"ABORTED".into()));
}

#[tokio::test]
async fn command_is_found_without_its_id() {
    let gateway = with_fate(Fate::Ends(Outcome::NoPart));
    assert_eq!(gateway.left("GET", "commands/latest", json!({})).await.status, 404);
    let body = json!({"width_mm": 20, "speed_mm_s": 50, "request_id": 17});
    let gripped = gateway.left("POST", "grip", body).await.body;
    gateway.left("POST", "home", json!({})).await;
    let found = gateway.left("GET", "commands/latest?request_id=17", json!({})).await;
    assert_eq!((found.status, found.body), (200, gripped));
    let latest = gateway.left("GET", "commands/latest", json!({})).await;
    assert_eq!((latest.status, &latest.body["kind"]), (200, &"home".into()));
    let unknown = gateway.left("GET", "commands/latest?request_id=18", json!({})).await;
    assert_eq!((unknown.status, &unknown.body["field"]), (404, &"request_id".into()));
    let own = gateway.ask("GET", "/api/v1/fleet/wsg/grippers/left/commands/latest?request_id=17", "").await;
    assert_eq!((own.status, &own.body["kind"]), (200, &"grip".into()));
}

#[tokio::test]
async fn refused_command_says_why_after_its_202() {
    let refusal = DeviceRefusal { command: "Grip", status: Status::E_NOT_INITIALIZED, fast_stop: None };
    let gateway = with_fate(Fate::Refused(refusal.into()));
    gateway.left("POST", "grip?wait_ms=0", json!({"width_mm": 20, "speed_mm_s": 50})).await;
    let command = gateway.left("GET", "commands/latest", json!({})).await;
    assert_eq!((command.status, &command.body["outcome"]), (200, &"REFUSED".into()));
    assert_eq!((&command.body["outcome_code"], &command.body["code"]), (&9.into(), &"not_referenced".into()));
    assert!(command.body["detail"].as_str().unwrap().contains("E_NOT_INITIALIZED"), "{}", command.body);
}

#[tokio::test]
async fn every_motion_becomes_its_action() {
    let mut gateway = Gateway::new(FakeScript::default());
    gateway.left("POST", "home", json!({"direction": "inner"})).await;
    assert_eq!(gateway.action().await, Action::Motion(Motion::Home(wsg::HomingDirection::Inner)));
    let body = json!({"width_mm": -5, "speed_mm_s": 100, "relative": true, "on_block": "clamp"});
    gateway.left("POST", "move", body).await;
    let Action::Motion(Motion::Move { flags, width, .. }) = gateway.action().await else { panic!() };
    assert_eq!((flags.relative, flags.stop_on_block, width.mm()), (true, false, -5.0));
    gateway.left("POST", "release", json!({"width_mm": 60.0, "speed_mm_s": 100.0})).await;
    let (width, speed) = (Width::new(60.0).unwrap(), Speed::new(100.0).unwrap());
    assert_eq!(gateway.action().await, Action::Motion(Motion::Release { width, speed }));
    gateway.ask("POST", "/api/v1/grippers/left/stop", "").await;
    assert_eq!(gateway.action().await, Action::Stop);
}

#[tokio::test]
async fn device_refusal_is_a_problem() {
    let refusal = DeviceRefusal { command: "Grip", status: Status::E_NOT_INITIALIZED, fast_stop: None };
    let gateway = with_fate(Fate::Refused(refusal.into()));
    let answer = gateway.left("POST", "grip", json!({"width_mm": 20, "speed_mm_s": 50})).await;
    assert_eq!((answer.status, &answer.body["code"]), (409, &"not_referenced".into()));
    assert_eq!(answer.body["device_status"], "E_NOT_INITIALIZED");
}

#[tokio::test]
async fn rejected_submission_is_a_problem() {
    let id = CommandId::generate();
    let gateway = with_fate(Fate::Rejected(Conflict::AlreadyRunning { id }.into()));
    let answer = gateway.left("POST", "home", json!({})).await;
    for name in ["command_id", "command"] {
        assert_eq!((answer.status, &answer.body[name]), (409, &id.to_string().into()), "{name}");
    }
    assert_eq!(answer.headers[header::CONTENT_TYPE], "application/problem+json");
    let invalid =
        Invalid::OutOfRange { field: "width_mm", value: 300.0, min: 0.0, max: 110.0, limit: "the device's stroke" };
    let gateway = with_fate(Fate::Rejected(invalid.into()));
    let answer = gateway.left("POST", "move", json!({"width_mm": 300, "speed_mm_s": 50})).await;
    assert_eq!((answer.status, &answer.body["max"]), (422, &110.0.into()));
}

#[tokio::test]
async fn malformed_stop_stops() {
    let mut gateway = Gateway::new(FakeScript::default());
    for body in ["{", "[]", "stop", "{\"width_mm\": 20}", "{\"lease\": 7}", "{\"request_id\": \"a\tb\"}"] {
        gateway.ask("POST", "/api/v1/grippers/left/stop", body).await;
        assert_eq!(gateway.action().await, Action::Stop, "{body}");
    }
    for query in ["wait_ms=abc", "wait_ms=70000", "wait_ms=1&wait_ms=1", "wait_ms=%FF"] {
        for path in ["/api/v1/grippers/left", "/api/v1/fleet/wsg/grippers/left"] {
            gateway.ask("POST", &format!("{path}/stop?{query}"), "").await;
            assert_eq!(gateway.action().await, Action::Stop, "{path} {query}");
        }
    }
    let long = "x".repeat(65);
    for (header, value) in [("Idempotency-Key", &*long), ("Wsg-Lease", &long), ("Wsg-Lease", "a\tb"), ("If-Match", "")]
    {
        let request = Request::post("/api/v1/grippers/left/stop").header(header::HOST, "localhost");
        gateway.send(request.header(header, value).body(Body::empty()).unwrap()).await;
        assert_eq!(gateway.action().await, Action::Stop, "{header}: {value}");
    }
}

#[tokio::test]
async fn part_id_can_be_a_number_and_a_body_padded() {
    let mut gateway = Gateway::new(FakeScript::default());
    let body = "{\"width_mm\": 20, \"speed_mm_s\": 50, \"part_id\": 4711}\0\0\0\0";
    gateway.ask("POST", "/api/v1/grippers/left/grip", body).await;
    let Action::Motion(Motion::Grip { part_id, .. }) = gateway.action().await else { panic!() };
    assert_eq!(part_id.unwrap().as_str(), "4711");
    assert_eq!(gateway.ask("POST", "/api/v1/grippers/left/home", "\0\0").await.status, 400);
    gateway.ask("POST", "/api/v1/grippers/left/home", "{}\0\0").await;
    assert_eq!(gateway.action().await, Action::Motion(Motion::Home(wsg::HomingDirection::Default)));
}

#[tokio::test]
async fn invalid_values_never_reach_the_gripper() {
    let mut gateway = Gateway::new(FakeScript::default());
    let cases = [
        (json!({"width_mm": 1e39, "speed_mm_s": 50}), 422, "width_mm"),
        (json!({"width_mm": "NaN", "speed_mm_s": 50}), 400, "width_mm"),
        (json!({"width_mm": 20, "speed_mm_s": "fast"}), 400, "speed_mm_s"),
        (json!({"width_mm": 20}), 400, "speed_mm_s"),
        (json!({"width_mm": 20, "speed_mm_s": 50, "forse_n": 1}), 400, "forse_n"),
        (json!({"width_mm": 20, "speed_mm_s": 50, "part_id": "x".repeat(49)}), 422, "part_id"),
        (json!({"width_mm": 20, "speed_mm_s": 50, "part_id": "a\u{7}"}), 400, "part_id"),
        (json!({"width_mm": 20, "speed_mm_s": 50, "part_id": 1.5}), 400, "part_id"),
    ];
    for (body, status, field) in cases {
        let answer = gateway.left("POST", "grip", body).await;
        assert_eq!((answer.status, &answer.body["field"]), (status, &field.into()), "{}", answer.body);
    }
    assert!(gateway.seen.try_recv().is_err());
}
