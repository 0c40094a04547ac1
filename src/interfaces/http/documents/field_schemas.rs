//! Schemas of single values, described where they are used.

use serde_json::{Map, Value, json};

use crate::operations::parameters::values::MAX_EXACT;

/// Describes the types of single values where they are used. Their names end in `Field`.
pub fn describe_in_place(document: &mut Value) {
    let Some(schemas) = document["components"]["schemas"].as_object_mut() else { return };
    let mut fields = Map::new();
    schemas.retain(|name, schema| {
        let is_field = name.ends_with("Field");
        if is_field {
            fields.insert(name.clone(), schema.clone());
        }
        !is_field
    });
    replace_references(document, &fields);
}

fn replace_references(value: &mut Value, fields: &Map<String, Value>) {
    match value {
        Value::Array(items) => items.iter_mut().for_each(|item| replace_references(item, fields)),
        Value::Object(object) => {
            replace_reference(object, fields);
            object.values_mut().for_each(|value| replace_references(value, fields));
        }
        _ => {}
    }
}

/// Replaces a reference to a field's schema, or the choice between such a reference and null, by the schema itself.
fn replace_reference(object: &mut Map<String, Value>, fields: &Map<String, Value>) {
    let alternatives = object.get("oneOf").and_then(Value::as_array);
    let is_nullable = alternatives.is_some_and(|all| all.contains(&json!({"type": "null"})));
    if alternatives.is_some_and(|all| all.len() > 1 + usize::from(is_nullable)) {
        return;
    }
    let found = alternatives.into_iter().flatten().filter_map(Value::as_object).chain([&*object]).find_map(|given| {
        let name = given.get("$ref")?.as_str()?.rsplit('/').next()?;
        Some((fields.get(name)?.as_object()?.clone(), given.get("description").cloned()))
    });
    let Some((schema, description)) = found else { return };
    object.remove("$ref");
    object.remove("oneOf");
    if let Some(description) = description {
        object.insert("description".to_owned(), description);
    }
    for (key, value) in schema {
        object.entry(key).or_insert(value);
    }
    if !is_nullable {
        return;
    }
    if let Some(kind) = object.get("type").and_then(Value::as_str) {
        let kinds = json!([kind, "null"]);
        object.insert("type".to_owned(), kinds);
    } else if let Some(alternatives) = object.get_mut("oneOf").and_then(Value::as_array_mut) {
        alternatives.push(json!({"type": "null"}));
    }
}

/// States the bound of whole numbers of 64 bits that have none: the greatest that every JSON parser represents exactly.
pub fn bound_numbers(value: &mut Value) {
    match value {
        Value::Array(items) => items.iter_mut().for_each(bound_numbers),
        Value::Object(object) => {
            if object.get("format").is_some_and(|format| format == "int64") {
                object.entry("maximum").or_insert(MAX_EXACT.into());
            }
            object.values_mut().for_each(bound_numbers);
        }
        _ => {}
    }
}
