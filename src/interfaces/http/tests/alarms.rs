//! Alarms that nobody raised.

use super::*;

#[tokio::test]
async fn alarms_are_acknowledged_by_their_ids() {
    let gateway = Gateway::new(FakeScript::default());
    assert_eq!(gateway.ask("GET", "/api/v1/alarms", "").await.body, json!({"alarms": []}));
    let path = "/api/v1/alarms/acknowledge";
    let many = vec!["019aa5c8-5a71-7d02-8c11-5b6f0e2d9a34"; 1025];
    for body in [json!({}), json!({"ids": []}), json!({"ids": ["left"]}), json!({"ids": many})] {
        let answer = gateway.ask("POST", path, body.to_string()).await;
        assert_eq!((answer.status, &answer.body["code"]), (400, &json!("malformed")));
    }
    let unknown = json!({"ids": [many[0]]});
    let answer = gateway.ask("POST", path, unknown.to_string()).await;
    assert_eq!((answer.status, answer.body), (200, json!({"acknowledged": [], "unknown": [many[0]]})));
}
