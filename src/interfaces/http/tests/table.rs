//! Consistency of the paths and their bodies with the table of operations.

use serde_json::{Map, Value, json};

use super::Gateway;
use crate::gripper::fake::FakeScript;
use crate::interfaces::http::requests::unknown_path::ONLY_HTTP;
use crate::interfaces::http::{API, openapi};
use crate::operations::{Operation, all};

/// Requests for another gateway, which performs the operation.
const FORWARDED: &str = "/fleet/{gateway}/";

#[test]
fn paths_and_operations_match() {
    let document = openapi();
    let paths = document["paths"].as_object().unwrap();
    for operation in all() {
        let path = paths.get(&format!("{API}{}", operation.path));
        let documented = path.and_then(|path| path.get(operation.verb.as_str().to_lowercase()));
        assert!(documented.is_some(), "{} has no path", operation.name);
    }
    for path in ONLY_HTTP {
        assert!(paths.contains_key(&format!("{API}{path}")), "{path} does not exist");
    }
    let api = paths.iter().filter_map(|(path, item)| Some((path.strip_prefix(API)?, item)));
    for (path, item) in api.filter(|(path, _)| !ONLY_HTTP.contains(path) && !path.starts_with(FORWARDED)) {
        for verb in item.as_object().unwrap().keys() {
            let is_it = |path_of: &str, verb_of: &str| path_of == path && verb_of.eq_ignore_ascii_case(verb);
            assert!(
                all().any(|operation| is_it(operation.path, operation.verb.as_str())),
                "{verb} {path} is not an operation"
            );
        }
    }
}

/// Status, code and detail of the answer to a request for an operation, sent to a gateway of its own.
async fn answer(operation: &Operation, body: &str) -> (u16, Value, Value) {
    let gateway = Gateway::new(FakeScript::default());
    let path = operation.path.replace("{gripper}", "left").replace("{finger}", "1").replace("{part_id}", "A-1047");
    let path = path.replace("{command}", "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f").replace("{webhook}", "mes");
    assert!(!path.contains('{'), "{path}");
    let answer = gateway.ask(operation.verb.as_str(), &format!("{API}{path}"), body.to_owned()).await;
    (answer.status, answer.body["code"].clone(), answer.body["detail"].clone())
}

fn changes() -> impl Iterator<Item = &'static Operation> {
    all().filter(|operation| operation.changes_something())
}

#[tokio::test]
async fn null_is_no_body() {
    for operation in changes() {
        let without = answer(operation, "").await;
        assert_eq!(answer(operation, "null").await, without, "{}", operation.name);
        let document = openapi();
        let body = &document["paths"][format!("{API}{}", operation.path)][operation.verb.as_str().to_lowercase()]["requestBody"];
        let is_required = body["required"] == json!(true);
        assert!(is_required || without.1 != "malformed", "{} needs no body: {without:?}", operation.name);
    }
}

/// Schema of an operation's body, if it has one.
fn schema<'a>(document: &'a Value, operation: &Operation) -> Option<&'a Value> {
    let path = &document["paths"][format!("{API}{}", operation.path)][operation.verb.as_str().to_lowercase()];
    let reference = path["requestBody"]["content"]["application/json"]["schema"]["$ref"].as_str()?;
    document.pointer(reference.strip_prefix('#')?)
}

fn allows_null(schema: &Value) -> bool {
    let types = schema["type"].as_array().into_iter().flatten();
    let alternatives = schema["oneOf"].as_array().into_iter().flatten().map(|one| &one["type"]);
    types.chain(alternatives).any(|kind| kind == "null")
}

#[tokio::test]
async fn null_field_counts_as_absent() {
    let document = openapi();
    let mut compared = 0;
    for operation in changes() {
        let Some(schema) = schema(&document, operation) else { continue };
        let Some(fields) = schema["properties"].as_object() else { continue };
        let required: Vec<_> = schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let example = schema["example"].as_object().cloned().unwrap_or_default();
        let given: Map<_, _> = example.into_iter().filter(|(name, _)| required.contains(&&**name)).collect();
        let mut with_nulls = given.clone();
        for (name, field) in fields.iter().filter(|(name, _)| !required.contains(&&***name)) {
            // The reason of a FAST STOP can have any type.
            let is_any = ["type", "oneOf", "$ref"].iter().all(|key| field.get(key).is_none());
            assert!(allows_null(field) || is_any, "{}: {name} {field}", operation.name);
            with_nulls.insert(name.clone(), Value::Null);
            compared += 1;
        }
        let [given, with_nulls] = [given, with_nulls].map(|fields| Value::Object(fields).to_string());
        assert_eq!(answer(operation, &with_nulls).await, answer(operation, &given).await, "{}", operation.name);
    }
    assert!(compared > 50, "{compared}");
}
