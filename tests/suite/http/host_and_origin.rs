//! Checks of `Host` and `Origin`; documentation and health endpoints.

use serde_json::json;

use crate::harness::{Gateway, Proxy, Simulator};

#[tokio::test]
async fn foreign_host_or_origin_is_refused() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::connected_to(proxy.address).await;
    let with = |name: &str, value: &str| gateway.request("POST", "home").header(name, value).json(&json!({}));
    gateway.send(with("Host", "evil.example")).await.problem(403, "foreign_host");
    gateway.send(with("Origin", "http://evil.example")).await.problem(403, "foreign_origin");
    gateway.send(with("Origin", "null")).await.problem(403, "foreign_origin");
    assert_eq!(proxy.frames.motions(), 0);
    let own = gateway.url("/").trim_end_matches('/').to_owned();
    gateway.send(with("Origin", &own)).await.outcome("SUCCESS");
    gateway.send(with("Host", "localhost")).await.outcome("SUCCESS");
}

#[tokio::test]
async fn documentation_and_health_need_no_internet() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::of(device.address).await;
    assert_eq!(
        gateway.get("/healthz").await.ok(),
        json!({"gateway": "gateway", "status": "ok", "fast_stop": "anyone"})
    );
    let document = gateway.get("/api/v1/openapi.json").await.ok();
    assert_eq!(document["openapi"], "3.1.0");
    assert!(document["paths"]["/api/v1/grippers/{gripper}/grip"]["post"].is_object());
    let page = gateway.get("/docs").await.ok();
    let page = page.as_str().unwrap();
    assert!(!page.contains("http://") && !page.contains("https://"), "{page}");
    let parts: Vec<_> = page.split('"').filter(|part| part.starts_with("docs/")).collect();
    assert_eq!(parts.len(), 4, "{page}");
    for part in parts {
        assert_eq!(gateway.get(&format!("/{part}")).await.status, 200, "{part}");
    }
}
