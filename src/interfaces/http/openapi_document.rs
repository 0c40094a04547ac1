//! The OpenAPI document that clients get: the declarations of the handlers, completed and adapted to code generators.

use serde_json::{Map, Value, json};
use utoipa::openapi::OpenApi;

use super::context::API;
use super::flatten::flatten;
use super::paths::responses::FORWARDED;

/// Paths of a gripper of this gateway, and of any gateway.
const OWN: &str = "/grippers/{gripper}";
const FORWARDED_TO: &str = "/fleet/{gateway}/grippers/{gripper}";

/// Completes a document.
pub fn completed(document: &OpenApi) -> Value {
    let mut document = serde_json::to_value(document).unwrap_or_default();
    add_forwarded(&mut document);
    flatten(&mut document);
    let schemas = document["components"]["schemas"].as_object_mut();
    schemas.into_iter().flat_map(Map::values_mut).for_each(describe_values);
    document
}

/// Adds the operations of a gripper a second time, below the name of the gateway that owns the gripper.
fn add_forwarded(document: &mut Value) {
    let own = format!("{API}{OWN}");
    let Some(paths) = document["paths"].as_object_mut() else { return };
    let of_gripper = |(path, item): (&String, &Value)| Some((path.strip_prefix(&own)?.to_owned(), item.clone()));
    for (rest, mut item) in paths.iter().filter_map(of_gripper).collect::<Vec<_>>() {
        item.as_object_mut().into_iter().flat_map(Map::values_mut).for_each(forward);
        paths.insert(format!("{API}{FORWARDED_TO}{rest}"), item);
    }
}

/// Turns an operation of a gripper into that of a gripper of any gateway.
fn forward(operation: &mut Value) {
    let text = |name: &str| operation[name].as_str().unwrap_or_default().to_owned();
    let (id, summary) = (text("operationId"), text("summary"));
    let description = format!(
        "Like `{id}`, for a gripper of any gateway on the Zenoh network. The gateway that owns the gripper decides. \
         `gateway_gone` means that nothing was sent to it; `gateway_timeout` means that the outcome is unknown."
    );
    (operation["summary"], operation["description"]) = (format!("{summary} (fleet)").into(), description.into());
    (operation["operationId"], operation["tags"]) = (format!("{id}_in_fleet").into(), json!(["fleet"]));
    let gateway = json!({
        "name": "gateway", "in": "path", "required": true, "example": "gateway",
        "description": "Name of the gateway that owns the gripper.",
        "schema": {"type": "string", "minLength": 1, "maxLength": 32, "pattern": "^[a-z0-9][a-z0-9_-]{0,31}$"},
    });
    if let Some(parameters) = operation["parameters"].as_array_mut() {
        parameters.insert(0, gateway);
    }
    if let Some(responses) = operation["responses"].as_object_mut() {
        for (status, name) in FORWARDED {
            responses.entry(*status).or_insert_with(|| json!({"$ref": format!("#/components/responses/{name}")}));
        }
    }
}

/// Copies the description of each value of an enumeration into the extensions that code generators read.
fn describe_values(schema: &mut Value) {
    let (Some(values), Some(text)) = (schema["enum"].as_array(), schema["description"].as_str()) else { return };
    let described = |value: &Value| {
        let begin = format!("- `{}`: ", value.as_str()?);
        let rest = text.split_once(&begin)?.1;
        let lines = rest.split("\n- ").next()?.split("\n\n").next()?;
        Some(lines.split_whitespace().collect::<Vec<_>>().join(" "))
    };
    let Some(texts) = values.iter().map(described).collect::<Option<Vec<_>>>() else { return };
    let by_value =
        values.iter().filter_map(Value::as_str).map(str::to_owned).zip(texts.iter().cloned().map(Value::from));
    let by_value: Map<_, _> = by_value.collect();
    schema["x-enumDescriptions"] = Value::Object(by_value);
    schema["x-enum-descriptions"] = json!(texts);
}
