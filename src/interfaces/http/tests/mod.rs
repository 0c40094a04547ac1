//! Tests of the router with a scripted gripper.

mod alarms;
mod device;
mod device_settings;
mod documents;
mod fast_stop;
mod fleet;
mod gateway;
mod journal;
mod lease;
mod motions;
mod raw;
mod table;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::{Request, header};
use futures_util::future::join_all;
use http_body_util::BodyExt;
use serde_json::{Value, json};
use tokio::sync::mpsc::UnboundedReceiver;
use tower::ServiceExt;

use super::context::HttpContext;
use super::requests::requested_operation::OperationPaths;
use super::router::router;
use crate::gripper::Rejection;
use crate::gripper::fake::{self, FakeScript, Fate, Seen};
use crate::journal::Journal;
use crate::model::{Action, CommandId};
use crate::wsg::{self, Data};

struct Gateway {
    paths: OperationPaths,
    router: Router,
    seen: UnboundedReceiver<Seen>,
}

struct Answer {
    status: u16,
    headers: axum::http::HeaderMap,
    body: Value,
}

impl Gateway {
    fn new(script: FakeScript) -> Self {
        Self::with_journal(script).0
    }

    fn with_journal(script: FakeScript) -> (Self, Journal) {
        let (handle, seen) = fake::gripper("left", script);
        let context = Arc::new(HttpContext::of([handle]));
        let journal = context.gateway.journal.clone();
        (Self { router: router(&context), paths: OperationPaths::default(), seen }, journal)
    }

    async fn send(&self, mut request: Request<Body>) -> Answer {
        self.paths.mark(&mut request);
        let (parts, body) = self.router.clone().oneshot(request).await.unwrap().into_parts();
        let bytes = body.collect().await.unwrap().to_bytes();
        let text = || String::from_utf8(bytes.to_vec()).map_or(Value::Null, Value::String);
        let body =
            if bytes.is_empty() { Value::Null } else { serde_json::from_slice(&bytes).unwrap_or_else(|_| text()) };
        Answer { status: parts.status.as_u16(), headers: parts.headers, body }
    }

    async fn ask(&self, method: &str, path: &str, body: impl Into<Body>) -> Answer {
        let request = Request::builder().method(method).uri(path).header(header::HOST, "localhost");
        self.send(request.body(body.into()).unwrap()).await
    }

    /// Sends a request for the gripper `left`.
    async fn left(&self, method: &str, path: &str, body: Value) -> Answer {
        self.ask(method, &format!("/api/v1/grippers/left/{path}"), body.to_string()).await
    }

    async fn action(&mut self) -> Action {
        match self.seen.recv().await.unwrap() {
            Seen::Submission(submission) => submission.action,
            other => panic!("{other:?}"),
        }
    }

    async fn exchanged(&mut self) -> wsg::Command {
        match self.seen.recv().await.unwrap() {
            Seen::Exchange(command) => command,
            other => panic!("{other:?}"),
        }
    }
}

fn with_fate(fate: Fate) -> Gateway {
    Gateway::new(FakeScript { fate, ..FakeScript::default() })
}

fn with_exchange(exchange: fn(&wsg::Command) -> Result<Data, Rejection>) -> Gateway {
    Gateway::new(FakeScript { exchange, ..FakeScript::default() })
}

#[tokio::test]
async fn unknown_path_is_a_problem() {
    let gateway = Gateway::new(FakeScript::default());
    let command = format!("/api/v1/grippers/left/commands/{}", CommandId::generate());
    let paths = [
        "/nowhere",
        "/api/v1/grippers/",
        "/api/v1/grippers/right",
        "/api/v1/grippers/NO%20NAME/state",
        "/api/v1/grippers/%FF/state",
        "/api/v1/grippers/left/commands/7",
        &command,
        "/docs/nothing.js",
        "/docs/",
    ];
    for path in paths {
        let answer = gateway.ask("GET", path, "").await;
        assert_eq!((answer.status, &answer.body["code"]), (404, &"not_found".into()), "{path}");
        assert_eq!(answer.headers[header::CONTENT_TYPE], "application/problem+json");
    }
}

#[tokio::test]
async fn unknown_path_names_the_nearest() {
    let gateway = Gateway::new(FakeScript::default());
    let detail = async |path: &str| gateway.ask("POST", path, "{}").await.body["detail"].as_str().unwrap().to_owned();
    for (path, nearest) in [
        ("/api/v1/grippers/left/grasp", "/api/v1/grippers/left/grip"),
        ("/api/v1/fleet/wsg/grippers/left/grasp", "/api/v1/fleet/wsg/grippers/left/grip"),
        ("/grippers/left/home", "/api/v1/grippers/left/home"),
    ] {
        assert_eq!(detail(path).await, format!("no such path: did you mean {nearest}? /docs lists all paths"));
    }
    assert_eq!(detail("/nowhere").await, "no such path: /docs lists all paths");
}

#[tokio::test]
async fn wrong_method_lists_the_allowed_ones() {
    let gateway = Gateway::new(FakeScript::default());
    let cases = [
        ("DELETE", "/api/v1/grippers", "GET,HEAD"),
        ("GET", "/api/v1/fast-stop", "POST"),
        ("POST", "/api/v1/grippers/left/settings/soft-limits", "GET,HEAD,PUT,DELETE"),
        ("POST", "/docs", "GET,HEAD"),
    ];
    for (method, path, allowed) in cases {
        let answer = gateway.ask(method, path, "").await;
        assert_eq!((answer.status, &answer.body["code"]), (405, &"method_not_allowed".into()), "{path}");
        let methods = |list: &str| list.split(',').map(str::to_owned).collect::<BTreeSet<_>>();
        assert_eq!(methods(answer.headers[header::ALLOW].to_str().unwrap()), methods(allowed));
    }
}

#[tokio::test]
async fn reads_do_not_reach_the_device() {
    let mut gateway = Gateway::new(FakeScript::default());
    let list = gateway.ask("GET", "/api/v1/grippers", "").await;
    assert_eq!(list.body["grippers"][0]["gripper"], "left");
    assert_eq!(gateway.ask("GET", "/api/v1/grippers/left", "").await.body["url"], "sim://wsg50");
    assert_eq!(gateway.ask("GET", "/api/v1/grippers/left/state", "").await.body["link"], "connecting");
    assert_eq!(
        gateway.ask("GET", "/healthz", "").await.body,
        json!({"gateway": "wsg", "status": "ok", "fast_stop": "anyone"})
    );
    assert!(gateway.seen.try_recv().is_err());
}

#[tokio::test]
async fn head_is_get_without_a_body() {
    let gateway = Gateway::new(FakeScript::default());
    let (get, head) = (gateway.ask("GET", "/healthz", "").await, gateway.ask("HEAD", "/healthz", "").await);
    assert_eq!((head.status, head.body), (200, Value::Null));
    assert_eq!(get.headers[header::CONTENT_LENGTH], head.headers[header::CONTENT_LENGTH]);
}

#[tokio::test]
async fn documentation_is_self_contained() {
    let gateway = Gateway::new(FakeScript::default());
    for path in ["/docs", "/docs/start.js", "/docs/swagger-ui.css", "/docs/swagger-ui-bundle.js"] {
        let answer = gateway.ask("GET", path, "").await;
        assert_eq!(answer.status, 200, "{path}");
        assert_eq!(answer.headers[header::X_CONTENT_TYPE_OPTIONS], "nosniff");
    }
    let page = gateway.ask("GET", "/docs", "").await;
    assert!(page.headers[header::CONTENT_SECURITY_POLICY].to_str().unwrap().contains("script-src 'self';"));
    assert_eq!(gateway.ask("GET", "/api/v1/openapi.json", "").await.body["openapi"], "3.1.0");
}

#[tokio::test]
async fn python_package_is_served_with_its_page() {
    let gateway = Gateway::new(FakeScript::default());
    let wheel = concat!("wsg_gateway-", env!("CARGO_PKG_VERSION"), "-py3-none-any.whl");
    let page = gateway.ask("GET", "/python/", "").await;
    assert!(page.body.as_str().unwrap().contains(&format!("href=\"{wheel}\"")));
    assert_eq!(gateway.ask("GET", "/python", "").await.headers[header::LOCATION], "python/");
    let served = gateway.ask("GET", &format!("/python/{wheel}"), "").await;
    assert_eq!(served.status, 200);
    assert_eq!(served.headers[header::CONTENT_TYPE], "application/zip");
}

#[tokio::test(start_paused = true)]
async fn missing_body_is_408() {
    let gateway = Gateway::new(FakeScript::default());
    let never = Body::from_stream(futures_util::stream::pending::<Result<&[u8], std::io::Error>>());
    let answer = gateway.ask("POST", "/api/v1/grippers/left/home", never).await;
    assert_eq!((answer.status, &answer.body["code"]), (408, &"request_timeout".into()));
}

#[tokio::test(start_paused = true)]
async fn repeated_refusals_are_delayed_except_for_fast_stop() {
    let gateway = Gateway::new(FakeScript::default());
    let begun = tokio::time::Instant::now();
    for _ in 0..100 {
        assert_eq!(gateway.left("POST", "move", json!({"width_mm": "wide"})).await.status, 400);
        assert_eq!(gateway.ask("POST", "/api/v1/grippers/right/fast-stop", "").await.status, 404);
    }
    assert_eq!(begun.elapsed(), Duration::ZERO);
    assert_eq!(gateway.left("POST", "move", json!({"width_mm": "wide"})).await.status, 400);
    let held_back_for = begun.elapsed();
    assert!(held_back_for >= Duration::from_millis(50), "{held_back_for:?}");
    // Other operations and accepted requests are not delayed.
    assert_eq!(gateway.left("POST", "grip", json!({"force_n": "much"})).await.status, 400);
    assert_eq!(gateway.ask("POST", "/api/v1/grippers/right/fast-stop", "").await.status, 404);
    assert_eq!(gateway.left("POST", "move", json!({"width_mm": 20, "speed_mm_s": 50})).await.status, 200);
    assert_eq!(begun.elapsed(), held_back_for);
    // At most 64 refusals are delayed at a time, so that connections remain for others.
    let begun = tokio::time::Instant::now();
    let refused = join_all((0..70).map(async |_| {
        assert_eq!(gateway.left("POST", "move", json!({"width_mm": "wide"})).await.status, 400);
        begun.elapsed()
    }));
    assert_eq!(refused.await.iter().filter(|after| after.is_zero()).count(), 70 - 64);
}
