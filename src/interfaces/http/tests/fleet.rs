//! Reads of all gateways, of which only this one is there.

use super::*;

#[tokio::test]
async fn fleet_reads_have_a_result_for_this_gateway() {
    let gateway = Gateway::new(FakeScript::default());
    for (path, member) in [("events?order=oldest", "events"), ("grips?kind=all", "grips"), ("readiness", "version")] {
        let answer = gateway.ask("GET", &format!("/api/v1/fleet/{path}"), "").await;
        let of_gateways = &answer.body["gateways"];
        assert_eq!((answer.status, of_gateways.as_array().unwrap().len()), (200, 1), "{path}: {}", answer.body);
        assert_eq!((&of_gateways[0]["gateway"], &of_gateways[0]["problem"]), (&json!("wsg"), &Value::Null));
        assert!(!of_gateways[0]["result"][member].is_null(), "{path}: {}", answer.body);
    }
}

#[tokio::test]
async fn mistake_in_a_fleet_read_is_a_problem() {
    let gateway = Gateway::new(FakeScript::default());
    for (query, status, field) in [
        ("cursor=5", 400, "cursor"),
        ("kind=stop", 400, "kind"),
        ("limit=101", 422, "limit"),
        ("gateway=A", 400, "gateway"),
        ("gateways=wsg", 400, "gateways"),
    ] {
        let answer = gateway.ask("GET", &format!("/api/v1/fleet/events?{query}"), "").await;
        assert_eq!((answer.status, &answer.body["field"]), (status, &json!(field)), "{query}");
    }
    let unknown = gateway.ask("GET", "/api/v1/fleet/events?gateway=cell-9", "").await;
    assert_eq!((unknown.status, &unknown.body["code"]), (404, &json!("not_found")));
}

#[tokio::test]
async fn fleet_acknowledge_needs_ids() {
    let gateway = Gateway::new(FakeScript::default());
    let path = "/api/v1/fleet/acknowledge";
    for body in [json!({}), json!({"fast_stop_ids": []}), json!({"fast_stop_ids": ["left"]})] {
        let answer = gateway.ask("POST", path, body.to_string()).await;
        assert_eq!((answer.status, &answer.body["code"]), (400, &json!("malformed")), "{body}");
    }
    let body = json!({"fast_stop_ids": [uuid::Uuid::now_v7()]}).to_string();
    assert_eq!(gateway.ask("POST", path, body).await.body, json!({"acknowledged": [], "failed": []}));
}
