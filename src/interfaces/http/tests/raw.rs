//! Raw requests, through the router.

use serde_json::json;

use super::*;
use crate::gripper::DeviceRefusal;
use crate::model::Motion;
use crate::wsg::{Acceleration, Status};

#[tokio::test]
async fn known_raw_id_takes_the_typed_path() {
    let mut gateway = Gateway::new(FakeScript::default());
    let answer = gateway.left("POST", "raw", json!({"id": 0x20, "payload": "02"})).await;
    assert_eq!(
        (answer.status, &answer.body["outcome"], &answer.body["name"]),
        (200, &"SUCCESS".into(), &"Homing".into())
    );
    assert!(answer.body["command_id"].is_string());
    assert_eq!(gateway.action().await, Action::Motion(Motion::Home(wsg::HomingDirection::Inner)));
    let answer = gateway.left("POST", "raw", json!({"id": 35.0})).await;
    assert_eq!((answer.status, &answer.body["status"]), (200, &"E_SUCCESS".into()));
    assert!(matches!(gateway.seen.recv().await, Some(Seen::FastStop(_))));
    let gateway = with_fate(Fate::Runs);
    let answer = gateway.left("POST", "raw?wait_ms=0", json!({"id": 0x22})).await;
    assert_eq!((answer.status, &answer.body["kind"]), (202, &"stop".into()));
}

#[tokio::test]
async fn raw_reply_has_the_wire_bytes() {
    let gateway = with_exchange(|command| match command {
        wsg::Command::Custom(custom) => Ok(Data::Custom(custom.payload().to_vec())),
        _ => Ok(Data::Acceleration(Acceleration::new(150.0).unwrap())),
    });
    let answer = gateway.left("POST", "raw", json!({"id": 0x31})).await;
    assert_eq!((&answer.body["payload"], &answer.body["status_code"]), (&"00001643".into(), &0.into()));
    // The value that is read back afterwards is not part of Set Acceleration's own reply.
    let answer = gateway.left("POST", "raw", json!({"id": 0x30, "payload": "00001643"})).await;
    assert_eq!(answer.body["payload"], "");
    let answer = gateway.left("POST", "raw", json!({"id": 0xB0, "payload": "aaaaaa"})).await;
    assert_eq!((&answer.body["payload"], &answer.body["name"]), (&"aaaaaa".into(), &Value::Null));
}

#[tokio::test]
async fn custom_command_is_a_motion_unless_listed_as_read() {
    let mut gateway = Gateway::new(FakeScript::default());
    let answer = gateway.left("POST", "raw", json!({"id": 0xB1, "payload": "00ff"})).await;
    assert_eq!((answer.status, &answer.body["outcome"]), (200, &"SUCCESS".into()));
    assert!(answer.body["command_id"].is_string());
    let custom = wsg::CustomCommand::new(0xB1, vec![0x00, 0xFF]).unwrap();
    assert_eq!(gateway.action().await, Action::Motion(Motion::Custom(custom)));
    let answer = gateway.left("POST", "raw", json!({"id": fake::READ_ID})).await;
    assert_eq!((answer.status, &answer.body["command_id"]), (200, &Value::Null));
    assert!(matches!(gateway.seen.recv().await, Some(Seen::Exchange(wsg::Command::Custom(_)))));
}

#[tokio::test]
async fn reserved_raw_requests_are_refused() {
    let mut gateway = Gateway::new(FakeScript::default());
    let cases = [
        (json!({"id": 0x07}), 400, "id"),
        (json!({"id": 0x24, "payload": "61636b"}), 400, "id"),
        (json!({"id": 0x40, "payload": "010a00"}), 400, "payload"),
        (json!({"id": 0x25, "payload": "00"}), 400, "payload"),
        (json!({"id": 0x25, "payload": "0000c07f00004842"}), 400, "payload"),
        (json!({"id": 0xAA}), 400, "id"),
        (json!({"id": 256}), 422, "id"),
        (json!({"id": 1.5}), 400, "id"),
        (json!({"id": 0xB0, "payload": "0"}), 400, "payload"),
        (json!({"id": 0xB0, "payload": "00".repeat(4097)}), 422, "payload"),
    ];
    for (body, status, field) in cases {
        let answer = gateway.left("POST", "raw", body).await;
        assert_eq!((answer.status, &answer.body["field"]), (status, &field.into()), "{}", answer.body);
    }
    assert!(gateway.seen.try_recv().is_err());
}

#[tokio::test]
async fn exact_raw_request_shows_the_devices_judgement() {
    let mut gateway = with_exchange(|command| {
        let status = Status::E_CMD_FORMAT_ERROR;
        Err(DeviceRefusal { command: wsg::id::name(command.id()).unwrap(), status, fast_stop: None }.into())
    });
    let answer = gateway.left("POST", "raw", json!({"id": 0x30, "payload": "00", "exact": true})).await;
    assert_eq!((answer.status, &answer.body["status"]), (200, &"E_CMD_FORMAT_ERROR".into()), "{}", answer.body);
    let command = wsg::Command::Verbatim(wsg::VerbatimCommand::new(0x30, vec![0]).unwrap());
    assert!(matches!(gateway.seen.recv().await, Some(Seen::Exchange(seen)) if seen == command));
    for id in [0x07, 0x20, 0x21, 0x22, 0x23, 0x24, 0x25, 0x26, 0x40, 0x41, 0x43, 0x44, 0x45, 0xAA] {
        let answer = gateway.left("POST", "raw", json!({"id": id, "exact": true})).await;
        assert_eq!((answer.status, &answer.body["field"]), (400, &"id".into()), "{id:02X}h: {}", answer.body);
    }
    assert!(gateway.seen.try_recv().is_err());
    let answer = gateway.left("POST", "raw", json!({"id": 0x30, "payload": "00"})).await;
    assert_eq!((answer.status, &answer.body["field"]), (400, &"payload".into()));
}
