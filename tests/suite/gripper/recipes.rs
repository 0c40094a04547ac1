//! Recipes: grips by part or number, parts outside the limits, versions, and the interfaces that share them.

use serde_json::{Value, json};

use crate::harness::{Answer, Gateway, JournalFile, Simulator, Socket, ZenohClient, eventually};

const RECIPE: &str = "/api/v1/recipes/A-1047";

/// Width of the part between the fingers of [`Simulator::with_part`], in mm.
const PART_MM: f64 = 20.0;

async fn homed() -> (Simulator, Gateway) {
    let device = Simulator::with_part().await;
    let gateway = Gateway::homed_at(device.address).await;
    (device, gateway)
}

/// A recipe that accepts parts of these widths.
fn recipe(accept_min_mm: f64, accept_max_mm: f64) -> Value {
    json!({"number": 12, "width_mm": PART_MM, "speed_mm_s": 200, "force_n": 30, "accept_min_mm": accept_min_mm,
        "accept_max_mm": accept_max_mm, "release_width_mm": 35, "release_speed_mm_s": 150})
}

/// Creates the recipe, and returns it.
async fn set(gateway: &Gateway, recipe: &Value) -> Value {
    let answer = gateway.put(RECIPE, recipe).await;
    assert_eq!(answer.status, 201, "{}", answer.body);
    answer.body
}

/// Returns the record of a grip, which appears a second after its end.
async fn record(gateway: &Gateway, grip: &Value) -> Value {
    let path = format!("/api/v1/grips/{}", grip["id"].as_str().unwrap());
    let stored = async || Some(gateway.get(&path).await).filter(|answer| answer.status == 200);
    eventually("the grip record", stored).await.ok()
}

#[tokio::test]
async fn part_or_number_alone_is_a_grip_by_recipe() {
    let (_device, gateway) = homed().await;
    let set = set(&gateway, &recipe(19.0, 21.0)).await;
    let fixed_fields = json!({"recipe": 12, "part_id": ""});
    for by in [
        json!({"part_id": "A-1047"}),
        json!({"recipe": 12}),
        json!({"recipe": 12, "part_id": "A-1047/0001"}),
        fixed_fields,
    ] {
        let held = gateway.post("grip", &by).await.outcome("PART_HELD");
        let record = record(&gateway, &held).await;
        let part_id = by.get("part_id").filter(|part_id| **part_id != "").cloned().unwrap_or(json!("A-1047"));
        let expected = json!({
            "part_id": part_id, "recipe": 12, "recipe_version": set["version"],
            "requested_width_mm": PART_MM, "requested_speed_mm_s": 200.0, "requested_force_n": 30.0,
            "accept_min_mm": 19.0, "accept_max_mm": 21.0, "contact_width_mm": held["contact_width_mm"],
        });
        for (name, value) in expected.as_object().unwrap() {
            assert_eq!(&record[name], value, "{name} in {record}");
        }
        let released = gateway.post("release", &json!({"recipe": 12})).await.outcome("SUCCESS");
        assert!((released["width_mm"].as_f64().unwrap() - 35.0).abs() < 0.5, "{released}");
    }
    let explicit = json!({"recipe": 12, "speed_mm_s": 100, "force_n": 20});
    let held = gateway.post("grip", &explicit).await.outcome("PART_HELD");
    let record = record(&gateway, &held).await;
    let requested = (&record["requested_speed_mm_s"], &record["requested_force_n"], &record["requested_width_mm"]);
    assert_eq!(requested, (&json!(100.0), &json!(20.0), &json!(PART_MM)));
}

#[tokio::test]
async fn complete_request_uses_no_recipe_of_its_part() {
    let (_device, gateway) = homed().await;
    gateway.put("settings/force-limit", &json!({"force_n": 10})).await.ok();
    set(&gateway, &recipe(PART_MM + 1.0, PART_MM + 2.0)).await;
    let grip = json!({"part_id": "A-1047", "width_mm": PART_MM, "speed_mm_s": 200});
    let held = gateway.post("grip", &grip).await.outcome("PART_HELD");
    assert!((held["force_n"].as_f64().unwrap() - 10.0).abs() < 1.0, "{held}");
    assert!(record(&gateway, &held).await.get("recipe").is_none());
}

#[tokio::test]
async fn repeated_request_is_the_same_command_after_a_change() {
    let (_device, gateway) = homed().await;
    set(&gateway, &recipe(19.0, 21.0)).await;
    let grip = json!({"recipe": 12, "request_id": "job 7"});
    let first = gateway.post("grip", &grip).await.outcome("PART_HELD");
    gateway.put(RECIPE, &recipe(18.0, 22.0)).await.ok();
    let again = gateway.post("grip", &grip).await.ok();
    assert_eq!((&again["id"], &again["replayed"]), (&first["id"], &json!(true)));
    let other = json!({"recipe": 12, "part_id": "A-1047/0002", "request_id": "job 7"});
    gateway.post("grip", &other).await.problem(409, "request_id_reused");
    gateway.post("release", &json!({"width_mm": 35, "speed_mm_s": 200})).await.outcome("SUCCESS");
    gateway.post("grip", &json!({"recipe": 12, "request_id": "job 8"})).await.outcome("PART_HELD");
    let stronger = json!({"recipe": 12, "force_n": 50, "request_id": "job 8"});
    gateway.post("grip", &stronger).await.problem(409, "request_id_reused");
}

#[tokio::test]
async fn grip_can_require_the_version_of_the_recipe() {
    let (_device, gateway) = homed().await;
    let version = set(&gateway, &recipe(19.0, 21.0)).await["version"].clone();
    gateway.put(RECIPE, &recipe(18.0, 22.0)).await.ok();
    let seen = json!({"recipe": 12, "recipe_version": version});
    let refused = gateway.post("grip", &seen).await.problem(412, "precondition_failed");
    assert_eq!(refused["field"], "recipe_version", "{refused}");
    gateway.post("release", &seen).await.problem(412, "precondition_failed");
    let newest = json!({"recipe": 12, "recipe_version": version.as_u64().unwrap() + 1});
    gateway.post("grip", &newest).await.outcome("PART_HELD");
}

#[tokio::test]
async fn request_without_a_recipe_needs_its_values() {
    let (_device, gateway) = homed().await;
    let missing = gateway.post("grip", &json!({"part_id": "B"})).await.problem(400, "malformed");
    assert_eq!(missing["field"], "width_mm", "{missing}");
    assert_eq!(gateway.post("grip", &json!({"recipe": 12})).await.problem(404, "not_found")["field"], "recipe");
    set(&gateway, &json!({"number": 12, "width_mm": PART_MM})).await;
    let without_speed = gateway.post("grip", &json!({"recipe": 12})).await.problem(400, "malformed");
    assert_eq!(without_speed["field"], "speed_mm_s", "{without_speed}");
    assert_eq!(gateway.post("release", &json!({"recipe": 12})).await.problem(400, "malformed")["field"], "width_mm");
    let none = json!({"recipe": 0, "part_id": "A-1047", "speed_mm_s": 200});
    assert_eq!(gateway.post("grip", &none).await.problem(400, "malformed")["field"], "width_mm");
}

#[tokio::test]
async fn part_outside_the_limits_is_the_wrong_part() {
    let (_device, gateway) = homed().await;
    set(&gateway, &recipe(PART_MM + 1.0, PART_MM + 2.0)).await;
    let wrong = gateway.post("grip", &json!({"recipe": 12})).await.outcome("WRONG_PART");
    assert_eq!(
        (&wrong["outcome_code"], &wrong["reached_goal"], &wrong["stalled"]),
        (&json!(11), &json!(false), &json!(true))
    );
    assert_eq!(gateway.state().await["state"], "HOLDING");
    let status = gateway.get("status").await.ok();
    let bits = ["done", "ok", "nok", "holding"].map(|bit| status[bit].as_bool().unwrap());
    assert_eq!(bits, [true, false, true, true], "{status}");
    let stored = record(&gateway, &wrong).await;
    assert_eq!((&stored["outcome"], &stored["contact_width_mm"]), (&json!("WRONG_PART"), &wrong["contact_width_mm"]));
    let listed = gateway.get("/api/v1/grips?outcome=WRONG_PART").await.ok();
    assert_eq!(listed["grips"].as_array().unwrap().len(), 1, "{listed}");

    // The limits of one gripper replace those of the others.
    gateway.post("release", &json!({"recipe": 12})).await.outcome("SUCCESS");
    let mut other = recipe(PART_MM + 1.0, PART_MM + 2.0);
    other["grippers"] = json!({"g": {"accept_min_mm": PART_MM - 2.0}});
    gateway.put(RECIPE, &other).await.ok();
    gateway.post("grip", &json!({"recipe": 12})).await.outcome("PART_HELD");
}

async fn with(gateway: &Gateway, method: &str, header: (&str, &str), body: &Value) -> (Answer, String) {
    let response = gateway.request(method, RECIPE).header(header.0, header.1).json(body).send().await.unwrap();
    let tag = response.headers().get("etag").map(|tag| tag.to_str().unwrap().to_owned()).unwrap_or_default();
    let status = response.status().as_u16();
    (Answer { status, location: None, body: response.json().await.unwrap() }, tag)
}

#[tokio::test]
async fn change_can_require_the_version_that_it_replaces() {
    let (_device, gateway) = homed().await;
    let (first, first_tag) = with(&gateway, "PUT", ("If-None-Match", "*"), &recipe(19.0, 21.0)).await;
    assert_eq!((first.status, first_tag.clone()), (201, format!("\"{}\"", first.body["version"])));
    let (again, _) = with(&gateway, "PUT", ("If-None-Match", "*"), &recipe(18.0, 21.0)).await;
    again.problem(412, "precondition_failed");
    let (second, second_tag) = with(&gateway, "PUT", ("If-Match", &first_tag), &recipe(18.0, 21.0)).await;
    assert_eq!(second.ok()["accept_min_mm"], 18.0);
    with(&gateway, "PUT", ("If-Match", &first_tag), &recipe(17.0, 21.0)).await.0.problem(412, "precondition_failed");
    for (tag, status, code) in
        [("W/\"x\"", 412, "precondition_failed"), ("\"1\", \"2\"", 400, "malformed"), ("", 400, "malformed")]
    {
        with(&gateway, "PUT", ("If-Match", tag), &recipe(17.0, 21.0)).await.0.problem(status, code);
    }
    with(&gateway, "DELETE", ("If-Match", &first_tag), &json!({})).await.0.problem(412, "precondition_failed");
    // A proxy that compresses the response turns the tag into a weak one.
    let weak_tag = format!("W/{first_tag}");
    with(&gateway, "DELETE", ("If-Match", &weak_tag), &json!({})).await.0.problem(412, "precondition_failed");
    let weak_tag = format!("W/{second_tag}");
    let (third, second_tag) = with(&gateway, "PUT", ("If-Match", &weak_tag), &recipe(17.0, 21.0)).await;
    assert_eq!(third.ok()["accept_min_mm"], 17.0);
    assert_eq!(gateway.put("/api/v1/recipes/B", &recipe(19.0, 21.0)).await.problem(409, "number_taken")["value"], 12);
    with(&gateway, "DELETE", ("If-Match", &second_tag), &json!({})).await.0.ok();
    gateway.get(RECIPE).await.problem(404, "not_found");
    let versions = gateway.get(&format!("{RECIPE}/versions")).await.ok();
    let removed: Vec<_> = versions["versions"].as_array().unwrap().iter().map(|one| &one["removed"]).collect();
    assert_eq!(removed, [true, false, false, false]);
    let events = gateway.events("kind=recipe&order=oldest", 4).await;
    let step = |event: &Value| (event["event"].as_str().unwrap().to_owned(), event["definition"]["part_id"].clone());
    let steps: Vec<_> = events.iter().map(step).collect();
    let expected =
        ["recipe_set", "recipe_set", "recipe_set", "recipe_removed"].map(|step| (step.to_owned(), json!("A-1047")));
    assert_eq!(steps, expected);
}

#[tokio::test]
async fn impossible_values_are_refused() {
    let (_device, gateway) = homed().await;
    for (field, value, status) in [
        ("number", json!(0), 422),
        ("number", json!(256), 422),
        ("number", json!(1.5), 400),
        ("width_mm", json!(-1), 422),
        ("accept_min_mm", json!(25), 400),
        ("description", json!("x".repeat(201)), 422),
        ("grippers", json!({"Left": {}}), 400),
        ("grippers", json!({"left": {"force_n": 1e6}}), 422),
        ("widht_mm", json!(1), 400),
        ("part_id", json!("B"), 400),
    ] {
        let mut wrong = recipe(19.0, 21.0);
        wrong[field] = value.clone();
        let refused = gateway.put(RECIPE, &wrong).await;
        let named = refused.field("field").as_str().unwrap().to_owned();
        assert!(refused.status == status && named.starts_with(field), "{field} {value}: {}", refused.body);
    }
    let mut misspelt = recipe(19.0, 21.0);
    misspelt["grippers"] = json!({"left": {"widht_mm": 1}});
    assert_eq!(gateway.put(RECIPE, &misspelt).await.problem(400, "malformed")["field"], "widht_mm");
    assert_eq!(gateway.get("/api/v1/recipes").await.ok()["recipes"], json!([]));
    let long = format!("/api/v1/recipes/{}", "x".repeat(49));
    assert_eq!(gateway.put(&long, &recipe(19.0, 21.0)).await.problem(422, "out_of_range")["field"], "part_id");
    let slash = gateway.put("/api/v1/recipes/A%2F1%20ü", &recipe(19.0, 21.0)).await;
    assert_eq!((slash.status, &slash.body["part_id"]), (201, &json!("A/1 ü")));
}

#[tokio::test(flavor = "multi_thread")]
async fn all_interfaces_share_the_recipes() {
    let (_device, gateway) = homed().await;
    let mut socket = Socket::open(&gateway).await;
    let mut given = recipe(19.0, 21.0);
    given["part_id"] = json!("ring 7/b");
    let set = socket.call("recipe.set", given.clone()).await;
    given["if_version"] = json!(0);
    let refused = socket.refused("recipe.set", given).await;
    assert_eq!(refused["data"]["code"], "precondition_failed", "{refused}");
    let zenoh = ZenohClient::of(&gateway).await;
    let key = |name: &str| format!("wsg/v1/gateway/command/{name}");
    let listed = zenoh.ask(&key("recipes"), &json!({})).await.unwrap();
    assert_eq!(listed["recipes"], json!([set]));
    let held = zenoh.ask("wsg/v1/gateway/g/command/grip?wait_ms=20000", &json!({"part_id": "ring 7/b"})).await.unwrap();
    assert_eq!(held["outcome"], "PART_HELD", "{held}");
    let removed = zenoh.ask(&key("recipe.remove"), &json!({"part_id": "ring 7/b"})).await.unwrap();
    assert_eq!((&removed["removed"], &removed["changed_by"]), (&json!(true), &json!("zenoh:unknown")));
    assert_eq!(gateway.get("/api/v1/recipes").await.ok()["recipes"], json!([]));
    // A query for the states of all grippers is not a command of the gateway.
    let states = zenoh.all("wsg/v1/*/*/state", "").await;
    assert!(states.len() == 1 && states[0].1.is_ok(), "{states:?}");
    let stopped = zenoh.ask("wsg/v1/gateway/*/fast-stop", &json!({"reason": "light curtain"})).await.unwrap();
    assert_eq!(gateway.state().await["fast_stop"], true, "{stopped}");
    let of_gripper = zenoh.ask(&key("grip"), &json!({"gripper": "g", "recipe": 12})).await.unwrap_err();
    assert_eq!(of_gripper["code"], "not_found", "{of_gripper}");
}

#[tokio::test]
async fn exported_table_is_imported_unchanged() {
    let (_device, gateway) = homed().await;
    let mut first = recipe(19.0, 21.0);
    first["part_id"] = json!("=1+1");
    first["description"] = json!("ring, \"left\"");
    first["grippers"] = json!({"g": {"force_n": 20.5}, "h": {"width_mm": 19.0}});
    let second = json!({"part_id": "B", "number": 7, "width_mm": 30.0});
    let set = gateway.put("/api/v1/recipes", &json!({"recipes": [first, second]})).await.ok();
    let table = gateway.get("/api/v1/recipes.csv").await.ok();
    let import = async |table: String| gateway.send(gateway.request("PUT", "/api/v1/recipes.csv").body(table)).await;
    let same = import(table.as_str().unwrap().to_owned()).await.ok();
    let version = |list: &Value, part: &str| {
        let find = |one: &&Value| one["part_id"] == part;
        list["recipes"].as_array().unwrap().iter().find(find).unwrap()["version"].clone()
    };
    assert_eq!(version(&same, "=1+1"), version(&set, "=1+1"), "{table}");
    let refused = import("part_id,number\nC,1\nD,7\n".to_owned()).await.problem(409, "number_taken");
    assert!(refused["detail"].as_str().unwrap().contains("\"B\""), "{refused}");
    gateway.get("/api/v1/recipes/C").await.problem(404, "not_found");
    import("part_id,number\nB,1\nD,7\n".to_owned()).await.ok();
    assert_eq!(gateway.get("/api/v1/recipes/B").await.ok()["number"], 1);
}

#[tokio::test]
async fn limits_are_proposed_from_grips() {
    let (_device, gateway) = homed().await;
    gateway.post(&format!("{RECIPE}/teach"), &json!({})).await.problem(404, "not_found");
    let mut widths = Vec::new();
    for _ in 0..3 {
        let grip = json!({"part_id": "A-1047", "width_mm": PART_MM, "speed_mm_s": 200});
        let held = gateway.post("grip", &grip).await.outcome("PART_HELD");
        widths.push(record(&gateway, &held).await["contact_width_mm"].as_f64().unwrap());
        gateway.post("release", &json!({"width_mm": 35, "speed_mm_s": 200})).await.outcome("SUCCESS");
    }
    let taught = gateway.post(&format!("{RECIPE}/teach"), &json!({"last": 50, "k": 2})).await.ok();
    let mean = widths.iter().sum::<f64>() / 3.0;
    let spread = (widths.iter().map(|width| (width - mean).powi(2)).sum::<f64>() / 2.0).sqrt();
    let figures =
        [("mean_mm", mean), ("standard_deviation_mm", spread), ("accept_min_mm", mean - (2.0 * spread).max(0.01))];
    for (name, expected) in figures {
        assert!((taught[name].as_f64().unwrap() - expected).abs() < 1e-9, "{name}: {taught}, {widths:?}");
    }
    assert_eq!(taught["count"], 3);
    let of_gripper = async |name| gateway.post(&format!("{RECIPE}/teach"), &json!({"k": 2, "gripper": name})).await;
    assert_eq!(of_gripper("g").await.ok(), taught);
    of_gripper("another").await.problem(404, "not_found");
    gateway.get(RECIPE).await.problem(404, "not_found");
}

#[tokio::test]
async fn recipes_survive_a_kill() {
    let device = Simulator::with_part().await;
    let journal = JournalFile::new();
    let gripper = format!("g=tcp://{}", device.address);
    let arguments = ["--gripper", &gripper, "--journal", &journal.path()];
    let gateway = Gateway::start(&arguments).await;
    let set = set(&gateway, &recipe(19.0, 21.0)).await;
    gateway.kill().await;
    let gateway = Gateway::start(&arguments).await;
    assert_eq!(gateway.get(RECIPE).await.ok(), set);
}
