//! Lists of events and grip records.

use super::*;
use crate::gripper::Recorder as _;
use crate::gripper::recorder::Record;
use crate::model::{Detail, Event, GatewayEvent, GripRecord, IdSource, Kind, Outcome, RequestedValues};
use jiff::Timestamp;

fn record(number: u64, kind: Kind) -> GripRecord {
    let at = Timestamp::from_millisecond(number.cast_signed()).unwrap();
    GripRecord {
        id: IdSource::new(number).command_id(at),
        gateway: "wsg".parse().unwrap(),
        gripper: "left".parse().unwrap(),
        serial_number: Some(4711),
        kind,
        part_id: None,
        outcome: Outcome::Success,
        code: None,
        detail: None,
        subject: "http:127.0.0.1".into(),
        requested: RequestedValues { requested_width_mm: Some(20.0), ..RequestedValues::default() },
        started_at: at,
        duration_ms: Some(1),
        width_mm: None,
        force_n: None,
        peak_force_n: None,
        travel_mm: 0.0,
        contact_width_mm: None,
        time_to_contact_ms: None,
        measured_at: None,
        samples: 0,
        curve: Vec::new(),
    }
}

/// Returns a gateway with these grip records.
async fn with_records(kinds: &[Kind]) -> Gateway {
    let (gateway, journal) = Gateway::with_journal(FakeScript::default());
    for (number, kind) in (1..).zip(kinds) {
        journal.record(Record::Grip(Box::new(record(number, *kind))));
    }
    let (told, durable) = tokio::sync::oneshot::channel();
    let ended = Event::new(Timestamp::UNIX_EPOCH, None, Detail::Gateway(GatewayEvent::Ended));
    journal.record(Record::Event(ended, Some(told)));
    durable.await.unwrap();
    gateway
}

#[tokio::test]
async fn grips_alone_are_listed_unless_more_is_requested() {
    let gateway = with_records(&[Kind::Home, Kind::Grip, Kind::Move, Kind::Release, Kind::Grip]).await;
    for (query, expected) in [
        ("", &[2, 5][..]),
        ("&kind=grip", &[2, 5]),
        ("&kind=home", &[1]),
        ("&kind=release", &[4]),
        ("&kind=all", &[1, 2, 3, 4, 5]),
    ] {
        let page = gateway.ask("GET", &format!("/api/v1/grips?order=oldest{query}"), "").await.body;
        let seqs: Vec<_> = page["grips"].as_array().unwrap().iter().map(|grip| grip["seq"].clone()).collect();
        assert_eq!(json!(seqs), json!(expected), "{query}");
    }
    let refused = gateway.ask("GET", "/api/v1/grips?kind=stop", "").await;
    assert_eq!((refused.status, &refused.body["field"]), (400, &json!("kind")));
}

#[tokio::test]
async fn pages_lead_forward_without_an_end() {
    let gateway = with_records(&[Kind::Grip; 3]).await;
    let first = gateway.ask("GET", "/api/v1/grips?limit=2&order=oldest&gripper=left", "").await;
    assert_eq!((&first.body["next_cursor"], &first.body["has_more"]), (&json!("2"), &json!(true)));
    assert_eq!(
        first.headers[header::LINK],
        r#"</api/v1/grips?limit=2&order=oldest&gripper=left&cursor=2>; rel="next""#
    );
    for cursor in [2, 3] {
        let path = format!("/api/v1/grips?limit=2&order=oldest&cursor={cursor}");
        let last = gateway.ask("GET", &path, "").await;
        assert_eq!((&last.body["next_cursor"], &last.body["has_more"]), (&json!("3"), &json!(false)));
        assert_eq!(last.headers.get(header::LINK), None);
    }
    let newest = gateway.ask("GET", "/api/v1/grips", "").await;
    assert_eq!((&newest.body["next_cursor"], &newest.body["has_more"]), (&Value::Null, &json!(false)));
}

#[tokio::test]
async fn lists_name_their_journal() {
    let gateway = with_records(&[Kind::Grip]).await;
    let id = gateway.ask("GET", "/api/v1/grips", "").await.body["journal_id"].as_str().unwrap().to_owned();
    assert_eq!(gateway.ask("GET", "/api/v1/events", "").await.body["journal_id"], *id);
    let request = Request::get("/api/v1/grips?order=oldest").header(header::HOST, "localhost");
    let table = gateway.send(request.header(header::ACCEPT, "text/csv").body(Body::empty()).unwrap()).await;
    assert_eq!(table.headers["journal-id"], id);
    assert_eq!(table.headers["next-cursor"], "1");
    for (accepted, is_table) in [
        ("text/csv; charset=utf-8", true),
        ("text/csv;header=present, application/json;q=0.5", true),
        ("application/json, text/csv; charset=utf-8", false),
        ("application/json;charset=utf-8", false),
        ("*/*", false),
        ("text/*; q=0.3", true),
    ] {
        let request = Request::get("/api/v1/grips").header(header::HOST, "localhost");
        let page = gateway.send(request.header(header::ACCEPT, accepted).body(Body::empty()).unwrap()).await;
        let kind = if is_table { "text/csv; charset=utf-8" } else { "application/json" };
        assert_eq!(page.headers[header::CONTENT_TYPE], kind, "{accepted}");
    }
    assert!(table.body.as_str().unwrap().ends_with(",wsg,4711,,,20.0,,,,,,,,,0.0,\n"), "{}", table.body);
}
