//! Command ids across the answer, the journal and the log.

use serde_json::{Value, json};

use crate::harness::{Gateway, Simulator};

#[tokio::test]
async fn answer_journal_and_log_share_the_command_id() {
    let device = Simulator::start(&[]).await;
    let gripper = format!("g=tcp://{}", device.address);
    let gateway = Gateway::start(&["--log-format", "json", "--gripper", &gripper]).await;
    gateway.until_link("connected").await;
    let id = gateway.post("home", &json!({})).await.outcome("SUCCESS")["id"].clone();
    let fast_stop_id = gateway.post("fast-stop", &json!({})).await.ok()["fast_stop_id"].clone();

    let events = gateway.events("kind=command&order=oldest", 2).await;
    assert_eq!(events.iter().map(|event| &event["phase"]).collect::<Vec<_>>(), ["admitted", "done"]);
    assert!(events.iter().all(|event| event["command_id"] == id), "{id} {events:?}");

    let ended = gateway.terminate().await;
    let lines: Vec<Value> = ended
        .stderr
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")))
        .collect();
    let said = |message: &str| lines.iter().filter(|line| line["message"] == message).collect::<Vec<_>>();
    // Lines of the actor and of the HTTP interface.
    assert_eq!(said("command admitted").iter().map(|line| &line["command"]).collect::<Vec<_>>(), [&id]);
    let ended = said("command ended");
    assert_eq!(
        ended.iter().map(|line| (&line["command"], &line["outcome"])).collect::<Vec<_>>(),
        [(&id, &json!("SUCCESS"))]
    );
    let answered = said("answered");
    let [home, fast_stop] = answered[..] else { panic!("{answered:?}") };
    assert_eq!((&home["span"]["command"], &home["status"]), (&id, &json!(200)), "{home}");
    assert_eq!(home["span"]["path"], "/api/v1/grippers/g/home", "{home}");
    assert_eq!((&fast_stop["span"]["fast_stop"], &said("FAST STOP latched")[0]["id"]), (&fast_stop_id, &fast_stop_id));
    assert!(lines.iter().all(|line| line["timestamp"].is_string() && line["level"].is_string()), "{lines:?}");
}
