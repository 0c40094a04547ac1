//! Schemas without `allOf`, for code generators: serde's flattened fields become fields of one object.
//!
//! An event has the fields of its kind beside the common ones, and many kinds have variants. Each kind becomes one
//! object with the fields of all its variants, of which only the common ones are required.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use super::asyncapi::reachable;

/// Schema of an event in the journal.
const EVENT: &str = "StoredEvent";
/// Field that tells the kinds of events apart.
const KIND: &str = "kind";

/// Fields of an object with their schemas, and the names of the required fields.
#[derive(Debug, Clone, Default, PartialEq)]
struct Fields {
    schemas: Map<String, Value>,
    required: Vec<Value>,
}

/// Flattens the schemas of a document, and drops those that nothing refers to any more.
pub fn flatten(document: &mut Value) {
    let Some(before) = document["components"]["schemas"].as_object().cloned() else { return };
    let mut schemas = before.clone();
    for (name, schema) in &mut schemas {
        if schema["allOf"].is_array()
            && let Some([fields]) = variants(&before[name], &before).as_deref()
        {
            *schema = object(fields.clone(), schema);
        }
    }
    let kinds = kinds(&before);
    let mut references = Vec::new();
    let mut mapping = Map::new();
    for (kind, fields) in kinds {
        let name = format!("{}Event", pascal(&kind));
        let place = format!("#/components/schemas/{name}");
        references.push(json!({"$ref": place}));
        mapping.insert(kind, place.into());
        let described = object(fields, &before[&name]);
        schemas.insert(name, described);
    }
    let event = &before[EVENT]["description"];
    let discriminator = json!({"propertyName": KIND, "mapping": mapping});
    schemas[EVENT] = json!({"description": event, "oneOf": references, "discriminator": discriminator});
    document["components"]["schemas"] = Value::Object(schemas);
    drop_unused(document);
}

fn object(Fields { schemas, required }: Fields, described: &Value) -> Value {
    let mut object = json!({"type": "object", "properties": schemas, "required": required});
    for key in ["description", "example"] {
        if let Some(value) = described.get(key) {
            object[key] = value.clone();
        }
    }
    object
}

/// Fields of each kind of event, from all its variants.
fn kinds(schemas: &Map<String, Value>) -> BTreeMap<String, Fields> {
    let mut kinds: BTreeMap<String, Fields> = BTreeMap::new();
    for variant in variants(&json!({"$ref": format!("#/components/schemas/{EVENT}")}), schemas).unwrap_or_default() {
        let kind = variant.schemas.get(KIND).and_then(|kind| kind["enum"][0].as_str()).unwrap_or_default().to_owned();
        match kinds.get_mut(&kind) {
            Some(fields) => fields.join(variant),
            None => drop(kinds.insert(kind, variant)),
        }
    }
    kinds
}

impl Fields {
    /// Adds the fields of another part of the same object.
    fn add(mut self, part: &Self) -> Self {
        self.schemas.extend(part.schemas.clone());
        let new = part.required.iter().filter(|name| !self.required.contains(name)).cloned().collect::<Vec<_>>();
        self.required.extend(new);
        self
    }

    /// Adds the fields of another variant. Only the fields that both require stay required.
    fn join(&mut self, variant: Self) {
        self.required.retain(|name| variant.required.contains(name));
        for (name, schema) in variant.schemas {
            match self.schemas.get_mut(&name) {
                Some(known) => *known = either(known, &schema),
                None => drop(self.schemas.insert(name, schema)),
            }
        }
    }
}

/// Variants of a schema as objects, or `None` if the schema allows other values than objects.
fn variants(schema: &Value, schemas: &Map<String, Value>) -> Option<Vec<Fields>> {
    if let Some(name) = schema["$ref"].as_str().and_then(|place| place.strip_prefix("#/components/schemas/")) {
        return variants(schemas.get(name)?, schemas);
    }
    if let Some(parts) = schema["allOf"].as_array() {
        let mut all = vec![Fields::default()];
        for part in parts {
            let part = variants(part, schemas)?;
            all = all.iter().flat_map(|fields| part.iter().map(|part| fields.clone().add(part))).collect();
        }
        return Some(all);
    }
    if let Some(alternatives) = schema["oneOf"].as_array() {
        let alternatives: Option<Vec<_>> = alternatives.iter().map(|schema| variants(schema, schemas)).collect();
        return Some(alternatives?.into_iter().flatten().collect());
    }
    let fields = schema["properties"].as_object().filter(|_| schema["type"] == "object")?;
    let required = schema["required"].as_array().cloned().unwrap_or_default();
    Some(vec![Fields { schemas: fields.clone(), required }])
}

/// Schema of a field that has one of two schemas: the types, values and descriptions of both, and the bounds that they
/// share.
fn either(one: &Value, other: &Value) -> Value {
    let (Some(left), Some(right)) = (one.as_object(), other.as_object()) else { return one.clone() };
    let (both, same_type) =
        (left.contains_key("type") && right.contains_key("type"), left.get("type") == right.get("type"));
    if left == right {
        return one.clone();
    }
    if !both {
        return json!({"anyOf": [one, other]});
    }
    let mut merged: Map<_, _> = left
        .iter()
        .filter(|(key, value)| right.get(*key) == Some(*value))
        .map(|(key, value)| (key.clone(), value.clone()))
        .collect();
    if !same_type {
        merged.insert("type".to_owned(), union(&left["type"], &right["type"]));
    }
    for (key, join) in [("enum", union as fn(&Value, &Value) -> Value), ("description", sentences)] {
        if let (Some(left), Some(right)) = (left.get(key), right.get(key)) {
            merged.insert(key.to_owned(), join(left, right));
        }
    }
    Value::Object(merged)
}

/// Values of two lists or single values, without duplicates.
fn union(one: &Value, other: &Value) -> Value {
    let mut all = list(one);
    all.extend(list(other));
    let mut seen = Vec::new();
    all.retain(|value| {
        !seen.contains(value) && {
            seen.push(value.clone());
            true
        }
    });
    Value::Array(all)
}

/// Returns the values of a list, or a single value.
fn list(value: &Value) -> Vec<Value> {
    value.as_array().cloned().unwrap_or_else(|| vec![value.clone()])
}

/// Joins two descriptions, unless the first contains the second.
fn sentences(one: &Value, other: &Value) -> Value {
    let left = one.as_str().unwrap_or_default();
    let right = other.as_str().unwrap_or_default();
    if left.contains(right) { one.clone() } else { format!("{left} / {right}").into() }
}

fn pascal(word: &str) -> String {
    word.split('_').filter(|part| !part.is_empty()).map(|part| part[..1].to_uppercase() + &part[1..]).collect()
}

/// Removes schemas that no operation reaches.
fn drop_unused(document: &mut Value) {
    let schemas = document["components"]["schemas"].take();
    let all = json!({"components": {"schemas": schemas}});
    document["components"]["schemas"] = Value::Object(reachable(document, &[&all]));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interfaces::http::openapi;
    use crate::journal::EventKind;

    #[test]
    fn each_kind_of_event_is_one_object() {
        let document = openapi();
        let schemas = &document["components"]["schemas"];
        let mapping = schemas[EVENT]["discriminator"]["mapping"].as_object().unwrap();
        assert_eq!(mapping.len(), schemas["EventKind"]["enum"].as_array().unwrap().len());
        for (kind, place) in mapping {
            assert!(serde_json::from_value::<EventKind>(kind.as_str().into()).is_ok(), "{kind}");
            let schema = document.pointer(place.as_str().unwrap().trim_start_matches('#')).unwrap();
            assert_eq!(schema["properties"][KIND]["enum"], json!([kind]));
            for common in ["seq", "at", "gripper", "subject", "door", "command_id", "kind"] {
                assert!(schema["required"].as_array().unwrap().contains(&common.into()), "{common} in {schema}");
            }
        }
        let command = &schemas["CommandEvent"]["properties"];
        assert_eq!(command["phase"]["enum"], json!(["admitted", "done"]));
        assert_eq!(command["width_mm"]["type"], json!(["number", "null"]));
    }

    #[test]
    fn no_schema_is_put_together_from_parts() {
        let document = openapi();
        for (name, schema) in document["components"]["schemas"].as_object().unwrap() {
            assert!(!schema.to_string().contains("\"allOf\""), "{name}: {schema}");
        }
    }
}
