//! Settings, through the router.

use serde_json::json;

use super::*;
use crate::gripper::DeviceRefusal;
use crate::wsg::{Acceleration, SoftLimits, Status, Width};

#[tokio::test]
async fn setting_is_read_back_from_the_device() {
    let mut gateway = with_exchange(|_| Ok(Data::Acceleration(Acceleration::new(5000.0).unwrap())));
    let answer = gateway.left("PUT", "settings/acceleration", json!({"acceleration_mm_s2": 6000})).await;
    assert_eq!(answer.body, json!({"gripper": "left", "acceleration_mm_s2": 5000.0}));
    assert_eq!(gateway.exchanged().await, wsg::Command::SetAcceleration(Acceleration::new(6000.0).unwrap()));
    let answer = gateway.left("GET", "settings/force-limit", Value::Null).await;
    assert_eq!((answer.status, &answer.body["code"]), (502, &"device_protocol".into()));
}

#[tokio::test]
async fn unset_settings_are_null() {
    let gateway = with_exchange(|command| match command {
        wsg::Command::ClearSoftLimits => Ok(Data::None),
        _ => Err(DeviceRefusal { command: "", status: Status::E_NOT_AVAILABLE, fast_stop: None }.into()),
    });
    let unset = json!({"gripper": "left", "minus_mm": null, "plus_mm": null});
    assert_eq!(gateway.left("GET", "settings/soft-limits", Value::Null).await.body, unset);
    assert_eq!(gateway.left("DELETE", "settings/soft-limits", Value::Null).await.body, unset);
    let answer = gateway.left("GET", "settings/device-tag", Value::Null).await;
    assert_eq!(answer.body, json!({"gripper": "left", "tag": null}));
    let answer = gateway.left("GET", "settings/overdrive", Value::Null).await;
    assert_eq!((answer.status, &answer.body["code"]), (503, &"link_down".into()));
}

#[tokio::test]
async fn swapped_soft_limits_are_out_of_range() {
    let gateway = with_exchange(|command| match command {
        wsg::Command::SetSoftLimits(limits) => Ok(Data::SoftLimits(*limits)),
        _ => Ok(Data::SoftLimits(SoftLimits::new(Width::ZERO, Width::ZERO).unwrap())),
    });
    let answer = gateway.left("PUT", "settings/soft-limits", json!({"minus_mm": 60, "plus_mm": 10})).await;
    assert_eq!((answer.status, &answer.body["field"], &answer.body["max"]), (422, &"minus_mm".into(), &10.0.into()));
    let answer = gateway.left("PUT", "settings/soft-limits", json!({"minus_mm": 10, "plus_mm": 60})).await;
    assert_eq!(answer.body, json!({"gripper": "left", "minus_mm": 10.0, "plus_mm": 60.0}));
}

#[tokio::test]
async fn tag_has_at_most_64_printable_characters() {
    let mut gateway = Gateway::new(FakeScript::default());
    for (tag, status) in
        [("x".repeat(65), 422), ("10 €".to_owned(), 400), ("a\n".to_owned(), 400), ("a\0".to_owned(), 400)]
    {
        let answer = gateway.left("PUT", "settings/device-tag", json!({"tag": tag})).await;
        assert_eq!((answer.status, &answer.body["field"]), (status, &"tag".into()));
    }
    assert!(gateway.seen.try_recv().is_err());
}
