//! The AsyncAPI document of the WebSocket, built from the HTTP API: its operations are the methods, with the same
//! schemas.

use std::collections::BTreeSet;

use serde_json::{Map, Value, json};
use utoipa::OpenApi as _;

use super::field_schemas::{bound_numbers, describe_in_place};
use crate::events::Gap;
use crate::interfaces::http::context::API;
use crate::interfaces::websocket::{MAX_ID_BYTES, SUBPROTOCOL, Subscribe, Subscribed};
use crate::model::{CommandReport, DamageRecord, FrameRecord, State, Telemetry};
use crate::operations::{Members, Operation as Method, all};

/// Notifications: name, schema and summary.
const NOTIFICATIONS: &[(&str, &str, &str)] = &[
    (
        "state",
        "GripperState",
        "The newest state of a gripper (topic `state`). A slow client misses intermediate states",
    ),
    (
        "telemetry",
        "Telemetry",
        "The newest measured values of a gripper (topic `telemetry`). A slow client misses intermediate values",
    ),
    ("event", "StoredEvent", "An event (topic `events`), sent in order once it is stored durably"),
    ("grip", "StoredGripRecord", "A new grip record, or one whose part was lost (topic `grips`)"),
    ("frame", "Frame", "A frame on the wire (topics `frames` and `exchanges`), sent in order"),
    (
        "damage",
        "Damage",
        "Bytes from a device that are not a valid frame (topics `frames` and `exchanges`), in order with the frames",
    ),
    ("fleet", "FleetGripper", "A gripper of any gateway (topic `fleet`): first all grippers, then each change"),
    (
        "alarms",
        "AlarmReport",
        "All alarms that are active or not acknowledged (topic `alarms`): first as they are, then after each change",
    ),
    ("gap", "Gap", "A gap in the events, grip records or frames, because the client was too slow"),
    ("command", "Command", "The end of a command that this socket started and that was still running when answered"),
];

/// Schemas that no HTTP operation refers to.
#[derive(utoipa::OpenApi)]
#[openapi(components(schemas(
    CommandReport,
    DamageRecord,
    FrameRecord,
    Gap,
    Members,
    State,
    Subscribe,
    Subscribed,
    Telemetry
)))]
struct OwnSchemas;

/// The messages of the document, and the operations that send or receive them.
#[derive(Default)]
struct Contents {
    messages: Map<String, Value>,
    operations: Map<String, Value>,
}

#[must_use]
pub fn document(openapi: &Value) -> Value {
    let mut own = serde_json::to_value(OwnSchemas::openapi()).unwrap_or_default();
    describe_in_place(&mut own);
    bound_numbers(&mut own);
    let mut contents = Contents::default();
    let follow =
        "Subscribe to states, telemetry, events, frames, the fleet or alarms. Replaces the previous subscription";
    contents.add_method(
        "subscribe",
        follow,
        &reference("components/schemas", "Subscribe"),
        reference("components/schemas", "Subscribed"),
    );
    let names: BTreeSet<_> = all().map(|method| method.name).collect();
    for name in names {
        let rows: Vec<_> = all().filter(|method| method.name == name).collect();
        let summary = rows.first().map(|row| operation_of(openapi, row)["summary"].clone()).unwrap_or_default();
        let summary = summary.as_str().unwrap_or_default();
        contents.add_method(name, summary, &params(openapi, &rows), result(openapi, &rows));
    }
    let Contents { mut messages, mut operations } = contents;
    for (name, schema, summary) in NOTIFICATIONS {
        let params = reference("components/schemas", schema);
        // The suffix avoids a clash with the method `command`.
        let message = format!("{name}.notification");
        messages.insert(message.clone(), titled(&message, summary, notification(name, &params)));
        operations.insert(message.clone(), operation("send", &message, summary, None));
    }
    messages.insert("error".to_owned(), titled("error", "Refusal of a request", answered("error", error())));
    let schemas = reachable(&json!(messages), &[openapi, &own]);
    let of_channel: Map<_, _> =
        messages.keys().map(|name| (name.clone(), reference("components/messages", name))).collect();
    let mut document = json!({
        "asyncapi": "3.0.0",
        "info": {
            "title": "WSG Gateway",
            "version": openapi["info"]["version"],
            "license": {"name": "MIT"},
            "description": format!(
                "JSON-RPC 2.0 over WebSocket, with the subprotocol {SUBPROTOCOL}. The methods are the operations of the \
                 HTTP API with the same fields, and the `data` of an error is the API's problem. A command is answered \
                 once it is admitted; the notification `command` reports its end. A batch has at most 32 requests, a \
                 message at most 64 KiB. The gateway sends a ping every second and closes a socket that has answered \
                 none for 3 seconds. FAST STOP is not a safety function in the sense of ISO 13850."
            ),
        },
        "defaultContentType": "application/json",
        "servers": {"gateway": {"host": "127.0.0.1:8080", "protocol": "ws"}},
        "channels": {"ws": {"address": format!("{API}/ws"), "messages": of_channel}},
        "operations": operations,
        "components": {"messages": messages, "schemas": schemas},
    });
    with_examples(&mut document);
    document
}

impl Contents {
    fn add_method(&mut self, name: &str, summary: &str, params: &Value, result: Value) {
        let answer = format!("{name}.answer");
        let reply =
            json!({"channel": reference("channels", "ws"), "messages": [of_channel(&answer), of_channel("error")]});
        self.operations.insert(name.to_owned(), operation("receive", name, summary, Some(reply)));
        self.messages.insert(name.to_owned(), titled(name, summary, request(name, params)));
        let message = titled(&answer, &format!("Result of `{name}`"), answered("result", result));
        self.messages.insert(answer, message);
    }
}

fn reference(place: &str, name: &str) -> Value {
    json!({"$ref": format!("#/{place}/{name}")})
}

fn of_channel(message: &str) -> Value {
    reference("channels/ws/messages", message)
}

fn operation(action: &str, message: &str, summary: &str, reply: Option<Value>) -> Value {
    let mut operation = json!({"action": action, "channel": reference("channels", "ws"), "summary": summary,
        "messages": [of_channel(message)]});
    if let Some(reply) = reply {
        operation["reply"] = reply;
    }
    operation
}

/// Returns a message. The payload's title is the message's name, because code generators name types by titles.
fn titled(name: &str, summary: &str, mut payload: Value) -> Value {
    payload["title"] = json!(name);
    json!({"name": name, "title": name, "summary": summary, "payload": payload})
}

fn id() -> Value {
    json!({"type": ["string", "integer", "null"], "maxLength": MAX_ID_BYTES})
}

fn notification(method: &str, params: &Value) -> Value {
    let properties = json!({"jsonrpc": {"const": "2.0"}, "method": {"const": method}, "params": params});
    json!({"type": "object", "required": ["jsonrpc", "method", "params"], "properties": properties})
}

/// Returns the schema of a request. A request without an `id` gets no response.
fn request(method: &str, params: &Value) -> Value {
    let needs_params = params["required"].as_array().is_some_and(|required| !required.is_empty());
    let mut request = notification(method, params);
    request["properties"]["id"] = id();
    request["properties"]["client"] = json!({
        "type": "string", "maxLength": 32,
        "description": "Name of the client's user, shown beside its subject; ignored if the client has a credential",
    });
    request["required"] =
        if needs_params { json!(["jsonrpc", "method", "params"]) } else { json!(["jsonrpc", "method"]) };
    request
}

fn answered(member: &str, value: Value) -> Value {
    let mut properties = json!({"jsonrpc": {"const": "2.0"}, "id": id()});
    properties[member] = value;
    json!({"type": "object", "required": ["jsonrpc", "id", member], "properties": properties})
}

fn error() -> Value {
    json!({
        "type": "object", "required": ["code", "message", "data"],
        "properties": {
            "code": {
                "enum": [-32700, -32600, -32601, -32602, -32603, -32000],
                "description": "JSON-RPC error code. -32000 means that the API refused the request: see `data.code`",
            },
            "message": {"type": "string", "description": "Human-readable description of the error"},
            "data": reference("components/schemas", "Problem"),
        },
    })
}

fn operation_of<'a>(openapi: &'a Value, method: &Method) -> &'a Value {
    &openapi["paths"][format!("{API}{}", method.path)][method.verb.as_str().to_lowercase()]
}

/// Returns the schema of a method's parameters: the body's fields, and the parameters that HTTP has elsewhere.
fn params(openapi: &Value, rows: &[&Method]) -> Value {
    let mut params = json!({"type": "object", "properties": {}, "additionalProperties": false});
    let mut required = BTreeSet::new();
    for method in rows {
        let operation = operation_of(openapi, method);
        let body = &operation["requestBody"]["content"]["application/json"]["schema"]["$ref"];
        if let Some(Value::Object(body)) =
            body.as_str().and_then(|place| openapi.pointer(place.trim_start_matches('#')))
        {
            required.extend(body.get("required").and_then(Value::as_array).into_iter().flatten().cloned().map(word));
            for (key, value) in body.iter().filter(|(key, _)| *key == "properties") {
                params[key] = value.clone();
            }
        }
    }
    for method in rows {
        let operation = operation_of(openapi, method);
        for parameter in operation["parameters"].as_array().into_iter().flatten() {
            let parameter = resolved(openapi, parameter);
            let name = word(parameter["name"].clone());
            let name = match parameter["in"].as_str() {
                Some("path") => name,
                Some("query") if name != "wait_ms" => name,
                _ => continue,
            };
            params["properties"][&name] = parameter["schema"].clone();
            // A parameter that one of the operations lacks is optional.
            if rows.iter().all(|row| row.path_parameters().any(|key| key == name)) {
                required.insert(name);
            }
        }
    }
    if !required.is_empty() {
        params["required"] = json!(required);
    }
    params
}

/// Returns a value of a document, or the component that it refers to.
fn resolved<'a>(document: &'a Value, value: &'a Value) -> &'a Value {
    let place = value["$ref"].as_str().and_then(|place| place.strip_prefix('#'));
    place.and_then(|place| document.pointer(place)).unwrap_or(value)
}

fn word(value: Value) -> String {
    if let Value::String(word) = value { word } else { String::new() }
}

/// Returns the schema of a method's result: any of the successful responses of its operations.
fn result(openapi: &Value, rows: &[&Method]) -> Value {
    let mut all = Vec::new();
    for method in rows {
        for status in ["200", "202"] {
            let schema = &operation_of(openapi, method)["responses"][status]["content"]["application/json"]["schema"];
            if schema.is_object() && !all.contains(schema) {
                all.push(schema.clone());
            }
        }
    }
    match all.as_slice() {
        [one] => one.clone(),
        all => json!({"anyOf": all}),
    }
}

/// Returns all schemas that are referenced, directly or through other schemas.
pub fn reachable(from: &Value, documents: &[&Value]) -> Map<String, Value> {
    let mut found = Map::new();
    let mut wanted = references(from);
    while let Some(name) = wanted.pop() {
        let schemas = documents.iter().map(|document| &document["components"]["schemas"][&name]);
        if let Some(schema) = schemas.into_iter().find(|schema| schema.is_object())
            && !found.contains_key(&name)
        {
            wanted.extend(references(schema));
            found.insert(name, schema.clone());
        }
    }
    found
}

fn references(value: &Value) -> Vec<String> {
    match value {
        Value::Object(members) => members
            .iter()
            .flat_map(|(key, value)| match value {
                Value::String(place) if key == "$ref" => {
                    place.strip_prefix("#/components/schemas/").map(ToOwned::to_owned).into_iter().collect()
                }
                value => references(value),
            })
            .collect(),
        Value::Array(items) => items.iter().flat_map(references).collect(),
        _ => Vec::new(),
    }
}

/// Turns OpenAPI's `example` into JSON Schema's `examples`.
fn with_examples(value: &mut Value) {
    match value {
        Value::Object(members) => {
            // In AsyncAPI, a discriminator is just a property name.
            if let Some(Value::String(name)) = members.get("discriminator").map(|found| found["propertyName"].clone()) {
                members.insert("discriminator".to_owned(), name.into());
            }
            if let Some(example) = members.remove("example") {
                members.insert("examples".to_owned(), json!([example]));
            }
            members.values_mut().for_each(with_examples);
        }
        Value::Array(items) => items.iter_mut().for_each(with_examples),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn parameters_outside_the_body_are_listed() {
        let document = super::document(&crate::interfaces::http::openapi());
        for (method, name) in
            [("settings.soft-limits.clear", "lease"), ("command.latest", "request_id"), ("grips.statistics", "window")]
        {
            let payload = &document["components"]["messages"][method]["payload"];
            assert!(payload["properties"]["params"]["properties"][name].is_object(), "{method}: {name}");
        }
        let state = &document["components"]["messages"]["state"]["payload"]["properties"]["params"];
        assert!(state["properties"]["lease"].is_null(), "a read takes no lease");
    }
}
