//! Statistics, fingers, tare and Loop, through the router.

use serde_json::json;

use super::*;
use crate::gripper::Failure;

#[tokio::test]
async fn device_replies_use_names_of_the_manual() {
    let gateway = with_exchange(|command| match command {
        wsg::Command::GetStatistics { .. } => {
            Ok(Data::Statistics(wsg::Statistics { total: 1520, no_part: 12, lost_part: 1 }))
        }
        wsg::Command::GetFingerInfo(finger) => {
            Ok(Data::FingerInfo(*finger, wsg::FingerInfo { finger_type: wsg::FingerType::Fmf, data_bytes: 4 }))
        }
        wsg::Command::GetFingerFlags(finger) => Ok(Data::FingerFlags(*finger, wsg::FingerFlags::POWER_ON)),
        wsg::Command::GetFingerData(finger) => Ok(Data::FingerData(*finger, vec![0xA0, 0x41])),
        wsg::Command::Loop(data) => Ok(Data::Loop(data.as_bytes().to_vec())),
        _ => Ok(Data::None),
    });
    let statistics = json!({"gripper": "left", "total": 1520, "no_part": 12, "lost_part": 1});
    assert_eq!(gateway.left("GET", "statistics", Value::Null).await.body, statistics);
    assert_eq!(gateway.left("POST", "statistics/reset", json!({})).await.body, statistics);
    let finger = json!({
        "gripper": "left", "finger": 2, "type": "WSG-FMF", "type_code": 1, "data_bytes": 4, "flags": ["POWER_ON"],
        "flags_raw": 1
    });
    assert_eq!(gateway.left("GET", "fingers/2", Value::Null).await.body, finger);
    let data = json!({"gripper": "left", "finger": 1, "data": "a041"});
    assert_eq!(gateway.left("GET", "fingers/1/data", Value::Null).await.body, data);
    let power = json!({"gripper": "left", "finger": 1, "enabled": false});
    assert_eq!(gateway.left("PUT", "fingers/1/power", json!({"enabled": false})).await.body, power);
    assert_eq!(gateway.left("GET", "fingers/3", Value::Null).await.status, 404);
    assert_eq!(gateway.left("POST", "tare", json!({})).await.body, json!({"gripper": "left", "tared": true}));
    let looped = gateway.left("POST", "loop", json!({"data": "00FF"})).await;
    assert_eq!(looped.body, json!({"gripper": "left", "data": "00ff"}));
}

#[tokio::test]
async fn link_down_is_503() {
    let gateway = with_exchange(|_| Err(Failure::Draining.into()));
    let answer = gateway.left("GET", "statistics", Value::Null).await;
    assert_eq!((answer.status, &answer.body["code"]), (503, &"link_down".into()));
}
