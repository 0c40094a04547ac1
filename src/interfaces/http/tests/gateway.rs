//! The gateway's own operations.

use super::*;
use crate::gripper::Now;
use crate::gripper::Recorder as _;
use crate::gripper::recorder::Record;
use crate::model::{Detail, Event, GatewayEvent};

#[tokio::test]
async fn readiness_names_its_causes() {
    let (gateway, journal) = Gateway::with_journal(FakeScript::default());
    let answer = gateway.ask("GET", "/readyz", "").await;
    assert_eq!(answer.status, 503);
    assert_eq!(
        answer.body,
        json!({
            "gateway": "wsg", "version": env!("CARGO_PKG_VERSION"), "ready": false, "journal_cause": null, "journal_damage": null,
            "journal_restored": null, "zenoh_cause": null,
            "not_ready": ["left: connecting: not reached yet"], "warnings": []
        })
    );

    journal.limit_pages(1);
    let mut health = journal.health();
    while health.borrow_and_update().failure.is_none() {
        let ended = Event::new(Now::read().wall, None, Detail::Gateway(GatewayEvent::Ended));
        let (told, durable) = tokio::sync::oneshot::channel();
        journal.record(Record::Event(ended, Some(told)));
        // The channel closes without a reply if the event is not stored.
        let _ = durable.await;
    }
    let answer = gateway.ask("GET", "/readyz", "").await;
    let cause = answer.body["journal_cause"].as_str().unwrap();
    assert!(answer.status == 503 && cause.contains("full"), "{cause}");
}

#[tokio::test]
async fn request_metrics_have_bounded_labels() {
    let gateway = Gateway::new(FakeScript::default());
    gateway.left("POST", "home", json!({})).await;
    gateway.left("POST", "home", json!({"direction": "up"})).await;
    for n in 0..3 {
        gateway.ask("GET", &format!("/nowhere/{n}"), "").await;
        gateway.ask(&format!("METHOD{n}"), "/healthz", "").await;
        gateway.ask("GET", &format!("/api/v1/grippers/none-{n}/state"), "").await;
    }
    let metrics = gateway.ask("GET", "/metrics", "").await;
    assert_eq!(metrics.headers[header::CONTENT_TYPE], "text/plain; version=0.0.4");
    let text = metrics.body.as_str().unwrap();
    let requests: Vec<_> = text.lines().filter_map(|line| line.strip_prefix("wsg_requests_total")).collect();
    assert_eq!(
        requests,
        [
            r#"{door="http",method="GET",route="/api/v1/grippers/{gripper}/state",status="404"} 3"#,
            r#"{door="http",method="GET",route="none",status="404"} 3"#,
            r#"{door="http",method="POST",route="/api/v1/grippers/{gripper}/home",status="200"} 1"#,
            r#"{door="http",method="POST",route="/api/v1/grippers/{gripper}/home",status="400"} 1"#,
            r#"{door="http",method="other",route="/healthz",status="405"} 3"#,
        ]
    );
}
