//! Files that describe the API: made anew from the operations and the routes, and compared with the checked-in files.
//! `WSG_TEST_WRITE=1 cargo test --lib documents` writes them.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::{Map, Value};
use strum::VariantArray as _;

use crate::access::Role;
use crate::interfaces::http::{asyncapi_document, openapi};
use crate::operations::{Operation, all};

const GUIDE: &str = "deploy/guide/websocket.md";
const HEADING: &str = "| method | HTTP | roles |\n| --- | --- | --- |\n";

fn compare(file: &str, made: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
    if std::env::var_os("WSG_TEST_WRITE").is_some() {
        std::fs::write(&path, made).unwrap();
    }
    let is_current = std::fs::read_to_string(&path).unwrap() == made;
    assert!(is_current, "{file} is stale: WSG_TEST_WRITE=1 cargo test --lib documents");
}

#[test]
fn openapi_document_is_current() {
    compare("openapi/openapi.json", &(serde_json::to_string_pretty(&openapi()).unwrap() + "\n"));
}

#[test]
fn asyncapi_document_is_current() {
    compare("openapi/asyncapi.yaml", &serde_saphyr::to_string(&asyncapi_document()).unwrap());
}

/// Row of an operation in the table of methods.
fn row(operation: &Operation) -> String {
    let path = operation.path.replacen("/grippers/{gripper}", "…", 1).replace(['{', '}'], "");
    let roles = Role::VARIANTS.iter().filter(|role| role.has(operation.right));
    let roles: Vec<_> = roles.map(ToString::to_string).collect();
    let roles = if roles.len() == Role::VARIANTS.len() { "all".to_owned() } else { roles.join(", ") };
    format!("| `{}` | `{} {path}` | {roles} |\n", operation.name, operation.verb)
}

#[test]
fn methods_in_the_guide_are_current() {
    let guide = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(GUIDE)).unwrap();
    let (before, rest) = guide.split_once(HEADING).unwrap();
    let (_, after) = rest.split_once("\n\n").unwrap();
    let mut made = format!(
        "{before}{HEADING}| `subscribe` | none: see [below](#subscribing) | observer, operator, supervisor |\n"
    );
    for operation in all() {
        made.push_str(&row(operation));
    }
    write!(made, "\n{after}").unwrap();
    compare(GUIDE, &made);
}

#[test]
fn parameters_are_objects_and_references_resolve() {
    for operation in all() {
        let (name, schema) = (operation.contract.fields)(&mut Vec::new());
        let schema = serde_json::to_value(&schema).unwrap();
        // The body of a FAST STOP can be anything.
        let is_any = schema.get("type").is_none() && schema["properties"]["reason"].is_object();
        assert!(schema["type"] == "object" || is_any, "{}: {name} is no plain object: {schema}", operation.name);
    }
    let document = openapi();
    let mut values = vec![&document];
    while let Some(value) = values.pop() {
        if let Some(place) = value.get("$ref").and_then(Value::as_str) {
            assert!(document.pointer(place.trim_start_matches('#')).is_some(), "{place} does not exist");
        }
        values.extend(value.as_object().into_iter().flat_map(Map::values));
        values.extend(value.as_array().into_iter().flatten());
    }
}
