//! Copies of recipes within a fleet.

use serde_json::{Value, json};

use super::fleet::Pair;

#[tokio::test(flavor = "multi_thread")]
async fn recipes_are_copied_to_another_gateway() {
    let pair = Pair::start().await;
    let recipe = |part: &str, number: u8| json!({"part_id": part, "number": number, "width_mm": 20, "speed_mm_s": 50});
    let recipes = json!({"recipes": [recipe("A", 1), recipe("B", 2)]});
    pair.near.put("/api/v1/recipes", &recipes).await.ok();
    let copy = async |body: Value| pair.near.post("/api/v1/fleet/copy-recipes", &body).await;
    let copied = copy(json!({"gateway": "far", "part_ids": ["B"]})).await.ok();
    assert_eq!(copied["copied"], json!(["B"]));
    assert_eq!(pair.far.get("/api/v1/recipes/B").await.ok()["number"], 2);
    pair.far.put("/api/v1/recipes/C", &json!({"number": 1})).await;
    let refused = copy(json!({"gateway": "far"})).await.problem(409, "number_taken");
    assert!(refused["detail"].as_str().unwrap().starts_with("gateway far refused"), "{refused}");
    pair.far.get("/api/v1/recipes/A").await.problem(404, "not_found");
    copy(json!({"gateway": "near"})).await.problem(400, "malformed");
    copy(json!({"gateway": "nowhere"})).await.problem(404, "not_found");
    copy(json!({"gateway": "far", "part_ids": ["D"]})).await.problem(404, "not_found");
}
