//! The OpenAPI document that clients get: the declarations of the handlers, completed and adapted to code generators.

use std::collections::{BTreeMap, BTreeSet};
use std::iter;

use serde_json::{Map, Value, json};
use utoipa::openapi::OpenApi;

use super::field_schemas::{bound_numbers, describe_in_place};
use super::flatten::flatten;
use super::meanings;
use super::paths;
use super::paths::parameters::in_path;
use super::paths::responses::{FORWARDED, references};
use crate::interfaces::http::context::API;

/// Paths of a gripper of this gateway, and of any gateway.
const OWN: &str = "/grippers/{gripper}";
const FORWARDED_TO: &str = "/fleet/{gateway}/grippers/{gripper}";

/// Completes a document.
pub fn completed(document: &OpenApi) -> Value {
    let mut document = serde_json::to_value(document).unwrap_or_default();
    paths::describe(&mut document);
    describe_in_place(&mut document);
    bound_numbers(&mut document);
    allow_null_fields(&mut document);
    add_forwarded(&mut document);
    share_parameters(&mut document);
    flatten(&mut document);
    for (name, meanings) in meanings::all() {
        if let Some(schema) = document["components"]["schemas"].get_mut(name) {
            meanings::describe(schema, &meanings);
        }
    }
    document
}

/// Lets each optional field of a request be `null`, as the parser of requests does.
fn allow_null_fields(document: &mut Value) {
    let paths = document["paths"].as_object().into_iter().flat_map(Map::values);
    let operations = paths.filter_map(Value::as_object).flat_map(Map::values);
    let schemas = operations.map(|operation| &operation["requestBody"]["content"]["application/json"]["schema"]);
    let references = schemas.filter_map(|schema| schema["$ref"].as_str()?.strip_prefix("#/components/schemas/"));
    let names: BTreeSet<_> = references.map(str::to_owned).collect();
    for name in names {
        let schema = &mut document["components"]["schemas"][name];
        let required = schema["required"].as_array().cloned().unwrap_or_default();
        let Some(fields) = schema["properties"].as_object_mut() else { continue };
        for (_, field) in fields.iter_mut().filter(|(name, _)| !required.contains(&name.as_str().into())) {
            allow_null(field);
        }
    }
}

fn allow_null(field: &mut Value) {
    if let Some(kind) = field["type"].as_str() {
        field["type"] = json!([kind, "null"]);
    } else if field.get("$ref").is_some() {
        let mut value = field.take();
        let default = value.as_object_mut().and_then(|value| value.remove("default"));
        *field = json!({"oneOf": [value, {"type": "null"}]});
        if let Some(default) = default {
            field["default"] = default;
        }
    }
}

/// Adds the operations of a gripper a second time, below the name of the gateway that owns the gripper.
fn add_forwarded(document: &mut Value) {
    let own = format!("{API}{OWN}");
    let Some(paths) = document["paths"].as_object_mut() else { return };
    let of_gripper: Vec<_> =
        paths.iter().filter_map(|(path, item)| Some((path.strip_prefix(&own)?.to_owned(), item.clone()))).collect();
    for (rest, mut item) in of_gripper {
        item.as_object_mut().into_iter().flat_map(Map::values_mut).for_each(forward);
        paths.insert(format!("{API}{FORWARDED_TO}{rest}"), item);
    }
}

/// Turns an operation of a gripper into that of a gripper of any gateway.
fn forward(operation: &mut Value) {
    let id = operation["operationId"].as_str().unwrap_or_default().to_owned();
    let summary = operation["summary"].as_str().unwrap_or_default().to_owned();
    let description = format!(
        "Like `{id}`, for a gripper of any gateway on the Zenoh network. The gateway that owns the gripper decides. \
         `gateway_gone` means that nothing was sent to it; `gateway_timeout` means that the outcome is unknown."
    );
    (operation["summary"], operation["description"]) = (format!("{summary} (fleet)").into(), description.into());
    (operation["operationId"], operation["tags"]) = (format!("{id}_in_fleet").into(), json!(["fleet"]));
    if let Some(parameters) = operation.get_mut("parameters").and_then(Value::as_array_mut) {
        parameters.insert(0, in_path("gateway"));
    }
    if let Some(responses) = operation["responses"].as_object_mut() {
        for (status, problem) in references(FORWARDED) {
            responses.entry(status).or_insert(problem);
        }
    }
}

/// Moves parameters that several operations have to the components.
fn share_parameters(document: &mut Value) {
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for parameter in parameters(&mut document["paths"]) {
        *counts.entry(parameter.to_string()).or_default() += 1;
    }
    let mut shared = Map::new();
    for parameter in parameters(&mut document["paths"]) {
        if counts.get(&parameter.to_string()).is_some_and(|count| *count > 1) {
            let [place, name] = ["in", "name"].map(|key| parameter[key].as_str().unwrap_or_default());
            let place = format!("{place}.{name}");
            // Parameters of one name can differ, such as the waits of reads and of commands.
            let mut names = iter::once(place.clone()).chain((2..).map(|number| format!("{place}.{number}")));
            let name = names.find(|name| shared.get(name).is_none_or(|other| other == parameter)).unwrap_or(place);
            let reference = json!({"$ref": format!("#/components/parameters/{name}")});
            shared.insert(name, std::mem::replace(parameter, reference));
        }
    }
    document["components"]["parameters"] = Value::Object(shared);
}

fn parameters(paths: &mut Value) -> impl Iterator<Item = &mut Value> {
    let items = paths.as_object_mut().into_iter().flat_map(Map::values_mut).filter_map(Value::as_object_mut);
    items.flat_map(Map::values_mut).filter_map(|operation| operation.get_mut("parameters")?.as_array_mut()).flatten()
}
