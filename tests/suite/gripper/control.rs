//! Control port of the simulated device.

use serde_json::Value;

use crate::harness::Simulator;

#[tokio::test]
async fn impossible_change_is_refused_with_its_limits() {
    let (_device, url) = Simulator::with_control().await;
    let http = reqwest::Client::new();
    let post = async |body: &'static str| {
        let answer = http.post(&url).body(body).send().await.unwrap();
        (answer.status().as_u16(), answer.text().await.unwrap())
    };
    for (body, status, expected) in [
        (r#"{"place_part": {"width_mm": -5}}"#, 422, "width_mm is -5; it must be from 0 to 110"),
        (
            r#"{"overheat": {"temperature_c": 1e9}}"#,
            422,
            "temperature_c is 1000000000; it must be from -273.1 to 3276.7",
        ),
        (r#"{"place_obstacle": {"width_mm": NaN}}"#, 400, "write it as"),
        (r#""no_such_thing""#, 400, "unknown variant"),
        (r#"{"place_part": {"width_mm": 20}}"#, 200, ""),
    ] {
        let (answered, text) = post(body).await;
        assert_eq!(answered, status, "{body}: {text}");
        assert!(text.contains(expected), "{body}: {text}");
    }
    let shown: Value = http.get(&url).send().await.unwrap().json().await.unwrap();
    assert_eq!((&shown["part"]["width_mm"], &shown["obstacle_mm"]), (&Value::from(20.0), &Value::Null), "{shown}");
}
