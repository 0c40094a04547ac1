//! Uses of the lease, through the router.

use std::time::Duration;

use serde_json::json;

use super::*;

#[tokio::test(start_paused = true)]
async fn each_use_renews_the_lease() {
    let gateway = with_fate(Fate::Runs);
    let token = gateway.left("POST", "lease", json!({"ttl_ms": 60_000})).await.body["token"].clone();
    let token = token.as_str().unwrap();
    let command = gateway.left("POST", "move?wait_ms=0", json!({"width_mm": 50, "speed_mm_s": 50})).await;
    let command = format!("commands/{}", command.body["id"].as_str().unwrap());
    let cancel = format!("{command}/cancel?wait_ms=0");
    let acknowledge = json!({"fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f"});
    for (method, path, body) in [
        ("GET", "", None),
        ("GET", "state", None),
        ("GET", "lease", None),
        ("PUT", "lease", Some(json!({}))),
        ("GET", &command, None),
        ("POST", &cancel, Some(json!({}))),
        ("POST", "fast-stop", None),
        ("POST", "acknowledge", Some(acknowledge)),
        ("GET", "statistics", None),
    ] {
        // The body of a FAST STOP is only a reason and carries no token.
        let places = if body.is_some() { vec![true, false] } else { vec![true] };
        for in_header in places {
            tokio::time::sleep(Duration::from_secs(1)).await;
            let path = format!("/api/v1/grippers/left/{path}");
            let mut request = Request::builder().method(method).uri(path.trim_end_matches('/'));
            request = request.header(header::HOST, "localhost");
            let mut body = body.clone().unwrap_or_default();
            if in_header {
                request = request.header("Wsg-Lease", token);
            } else {
                body["lease"] = token.into();
            }
            let _ = gateway.send(request.body(body.to_string().into()).unwrap()).await;
            let left = gateway.left("GET", "lease", Value::Null).await.body["expires_in_ms"].as_u64();
            assert!(left > Some(59_500), "{method} {path}: {left:?}");
        }
    }
}

#[tokio::test]
async fn fast_stop_ignores_invalid_tokens() {
    let mut gateway = Gateway::new(FakeScript::default());
    for token in ["stale", "x y", &"x".repeat(1000)] {
        let request = Request::builder().method("POST").uri("/api/v1/grippers/left/fast-stop");
        let request = request.header(header::HOST, "localhost").header("Wsg-Lease", token);
        assert_eq!(gateway.send(request.body(Body::empty()).unwrap()).await.status, 200);
        assert!(matches!(gateway.seen.recv().await, Some(Seen::FastStop(_))));
    }
}

#[tokio::test]
async fn ambiguous_holder_name_is_refused() {
    let gateway = with_fate(Fate::Runs);
    for (holder, remedy) in [
        ("\u{202E}tobor", "U+202E"),
        ("ro\u{200B}bot", "U+200B"),
        ("r\u{43E}bot", "use only one"),
        ("Mu\u{308}ller", "NFC"),
    ] {
        let answer = gateway.left("POST", "lease", json!({"holder": holder})).await;
        assert_eq!(answer.status, 400, "{holder:?}");
        assert_eq!((&answer.body["code"], &answer.body["field"]), (&json!("malformed"), &json!("holder")));
        assert!(answer.body["detail"].as_str().unwrap().contains(remedy), "{}", answer.body);
    }
    let long = gateway.left("POST", "lease", json!({"holder": "ü".repeat(17)})).await;
    assert_eq!((long.status, &long.body["max"]), (422, &json!(32)), "in bytes: {}", long.body);
    let taken = gateway.left("POST", "lease", json!({"holder": "Müller #1"})).await;
    assert_eq!(taken.body["holder"], "Müller #1");
}
