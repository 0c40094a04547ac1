//! FAST STOP and its acknowledgement, through the router.

use serde_json::json;

use super::*;
use crate::gripper::Conflict;
use crate::model::Action;

#[tokio::test]
async fn fast_stop_ignores_invalid_bodies() {
    let mut gateway = Gateway::new(FakeScript::default());
    let huge = "x".repeat(1024 * 1024);
    let long = json!({"reason": "é".repeat(100)}).to_string();
    let bodies = ["", "{", "null", "[1]", r#"{"reason": 7}"#, r#"{"reason": "curtain"}"#, &long, &huge];
    for body in bodies {
        let answer = gateway.ask("POST", "/api/v1/grippers/left/fast-stop", body.to_owned()).await;
        assert_eq!((answer.status, &answer.body["fast_stop_confirmed"]), (200, &true.into()));
        assert!(answer.body["fast_stop_id"].is_string());
        let Seen::FastStop(reason) = gateway.seen.recv().await.unwrap() else { panic!() };
        let expected = match body {
            r#"{"reason": "curtain"}"# => "curtain".to_owned(),
            body if body == long => "é".repeat(32),
            _ => String::new(),
        };
        assert_eq!(reason.as_str(), expected);
    }
}

#[tokio::test(start_paused = true)]
async fn fast_stop_does_not_wait_for_its_body() {
    let gateway = Gateway::new(FakeScript::default());
    let never = Body::from_stream(futures_util::stream::pending::<Result<&[u8], std::io::Error>>());
    let start = tokio::time::Instant::now();
    let answer = gateway.ask("POST", "/api/v1/fast-stop", never).await;
    assert_eq!((answer.status, &answer.body["confirmed"]), (200, &json!(["left"])));
    assert!(start.elapsed() <= super::super::requests::fast_stop::REASON_TIME + crate::gripper::handle::FAST_STOP_WAIT);
}

#[tokio::test(start_paused = true)]
async fn stop_does_not_wait_for_its_body() {
    let mut gateway = Gateway::new(FakeScript::default());
    let never = Body::from_stream(futures_util::stream::pending::<Result<&[u8], std::io::Error>>());
    let start = tokio::time::Instant::now();
    let answer = gateway.ask("POST", "/api/v1/grippers/left/stop", never).await;
    assert_eq!(answer.status, 200);
    let Some(Seen::Submission(submission)) = gateway.seen.recv().await else { panic!("no Stop") };
    assert_eq!(submission.action, Action::Stop);
    assert!(start.elapsed() <= super::super::requests::fast_stop::REASON_TIME + crate::gripper::handle::FAST_STOP_WAIT);
}

#[tokio::test(start_paused = true)]
async fn unconfirmed_fast_stop_is_reported() {
    let gateway = Gateway::new(FakeScript { confirms: false, ..FakeScript::default() });
    let answer = gateway.ask("POST", "/api/v1/fast-stop", "").await;
    assert_eq!((answer.status, &answer.body["fast_stop_confirmed"]), (200, &false.into()));
    assert_eq!((&answer.body["confirmed"], &answer.body["unconfirmed"]), (&json!([]), &json!(["left"])));
}

#[tokio::test]
async fn acknowledge_names_its_fast_stop() {
    let mut gateway = Gateway::new(FakeScript::default());
    let id = "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f";
    let answer = gateway.left("POST", "acknowledge", json!({"fast_stop_id": id})).await;
    assert_eq!(answer.body, json!({"gripper": "left", "fast_stop_id": id, "fast_stop": false}));
    assert!(matches!(gateway.seen.recv().await, Some(Seen::Acknowledge(named)) if named.to_string() == id));
    for wrong in [json!({"fast_stop_id": "newest"}), json!({}), json!({"fast_stop_id": 7})] {
        let answer = gateway.left("POST", "acknowledge", wrong).await;
        assert_eq!((answer.status, &answer.body["field"]), (400, &"fast_stop_id".into()));
    }
    let given = id.parse().unwrap();
    let acknowledge = Err(Conflict::StaleFastStop { given, current: None }.into());
    let gateway = Gateway::new(FakeScript { acknowledge, ..FakeScript::default() });
    let answer = gateway.left("POST", "acknowledge", json!({"fast_stop_id": id})).await;
    assert_eq!((answer.status, &answer.body["code"]), (409, &"stale_fast_stop".into()));
}

#[tokio::test]
async fn foreign_page_cannot_fast_stop() {
    let mut gateway = Gateway::new(FakeScript::default());
    for (header, value, code) in
        [(header::HOST, "evil.example", "foreign_host"), (header::ORIGIN, "null", "foreign_origin")]
    {
        let mut request = Request::post("/api/v1/fast-stop").header(header::HOST, "localhost");
        request.headers_mut().unwrap().insert(header, value.parse().unwrap());
        let answer = gateway.send(request.body(Body::empty()).unwrap()).await;
        assert_eq!((answer.status, &answer.body["code"]), (403, &code.into()));
    }
    assert!(gateway.seen.try_recv().is_err());
}
