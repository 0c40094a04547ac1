//! Alarms of a gateway: raised, shared by all clients, and acknowledged.

use serde_json::{Value, json};

use crate::harness::{Gateway, Simulator, Socket, eventually};

async fn alarms(gateway: &Gateway) -> Vec<Value> {
    let answer = gateway.send(gateway.request("GET", "/api/v1/alarms")).await.ok();
    answer["alarms"].as_array().unwrap().clone()
}

#[tokio::test]
async fn fast_stop_alarm_ends_with_its_latch() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::connected_to(device.address).await;
    let mut socket = Socket::open(&gateway).await;
    socket.call("subscribe", json!({"topics": ["alarms"]})).await;
    let stopped = gateway.post("fast-stop", &json!({"reason": "light curtain"})).await.ok();
    socket.notification("alarms", |list| list["alarms"][0]["alarm"] == "fast_stop").await;
    let alarm = alarms(&gateway).await[0].clone();
    let said = (&alarm["fast_stop_id"], &alarm["fast_stop_reason"], &alarm["cause"], &alarm["priority"]);
    assert_eq!(said, (&stopped["fast_stop_id"], &json!("light curtain"), &json!("requested"), &json!("critical")));

    // The acknowledgement of the alarm clears nothing at the gripper.
    let ids = json!({"ids": [alarm["id"]]});
    let answer = gateway.send(gateway.request("POST", "/api/v1/alarms/acknowledge").json(&ids)).await.ok();
    assert_eq!(answer["acknowledged"][0]["acknowledged_by"], "http:127.0.0.1", "{answer}");
    assert_eq!(gateway.state().await["fast_stop"], true);
    assert_eq!(alarms(&gateway).await.len(), 1);

    let id = json!({"fast_stop_id": stopped["fast_stop_id"]});
    gateway.post("acknowledge", &id).await.ok();
    socket.notification("alarms", |list| list["alarms"] == json!([])).await;
    assert_eq!(alarms(&gateway).await, Vec::<Value>::new());
    let history = gateway.events("kind=alarm&order=oldest", 3).await;
    let steps: Vec<_> = history.iter().map(|event| (&event["event"], &event["gripper"], &event["subject"])).collect();
    let (raised, acknowledged, ended) = (json!("raised"), json!("acknowledged"), json!("ended"));
    let (gripper, client) = (json!("g"), json!("http:127.0.0.1"));
    let expected =
        [(&raised, &gripper, &Value::Null), (&acknowledged, &gripper, &client), (&ended, &gripper, &Value::Null)];
    assert_eq!(steps, expected);
}

#[tokio::test]
async fn lost_link_is_an_alarm_until_acknowledged() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::connected_to(device.address).await;
    device.terminate().await;
    let is_down = async || alarms(&gateway).await.into_iter().find(|alarm| alarm["alarm"] == "link_down");
    let alarm = eventually("the alarm is raised", is_down).await;
    assert_eq!((&alarm["gripper"], &alarm["ended_at"], &alarm["count"]), (&json!("g"), &Value::Null, &json!(1)));
}
