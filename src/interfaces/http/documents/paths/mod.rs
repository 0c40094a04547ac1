//! The operations over HTTP: their routes, and their part of the OpenAPI document.

pub mod parameters;
pub mod responses;

use std::sync::Arc;

use axum::Router;
use axum::extract::{Request, State};
use axum::routing::{MethodFilter, on};
use serde_json::{Map, Value, json};

use crate::interfaces::http::context::{API, HttpContext};
use crate::interfaces::http::requests::operation::serve;
use crate::model::Urgency;
use crate::operations::calls::contract::{Answer, Schemas};
use crate::operations::{Operation, all};

pub use parameters::CommandPath;

/// Returns the routes of all operations.
pub fn routes() -> Router<Arc<HttpContext>> {
    let mut router = Router::new();
    for operation in all() {
        let Ok(verb) = MethodFilter::try_from(operation.verb.clone()) else { continue };
        let handler = on(verb, move |State(context): State<Arc<HttpContext>>, request: Request| async move {
            serve(&context, operation, request).await
        });
        if operation.urgency == Urgency::FastStop {
            // A FAST STOP with a trailing slash is accepted.
            router = router.route(&format!("{}/", operation.path), handler.clone());
        }
        router = router.route(operation.path, handler);
    }
    router
}

/// Adds all operations to an OpenAPI document.
pub fn describe(document: &mut Value) {
    let mut schemas = Schemas::new();
    for operation in all() {
        let described = described(operation, &mut schemas);
        document["paths"][format!("{API}{}", operation.path)][operation.verb.as_str().to_lowercase()] = described;
    }
    for (name, schema) in schemas {
        document["components"]["schemas"][name] = json!(schema);
    }
}

fn described(operation: &Operation, schemas: &mut Schemas) -> Value {
    let (name, schema) = (operation.contract.fields)(schemas);
    let fields = json!(schema);
    let description = paragraphs(operation.doc);
    let mut described = json!({
        "tags": [operation.tag],
        "summary": operation.summary(),
        "operationId": operation.id,
        "responses": responses(operation, schemas),
    });
    let parameters = parameters::of(operation, &fields);
    if !parameters.is_empty() {
        described["parameters"] = parameters.into();
    }
    if !description.is_empty() {
        described["description"] = description.into();
    }
    let has_body = operation.changes_something() && fields["properties"].as_object().is_some_and(|own| !own.is_empty());
    if has_body {
        let mut body = json!({"content": {"application/json": {"schema": reference(&name)}}});
        let has_required_field = fields["required"].as_array().is_some_and(|required| !required.is_empty());
        if has_required_field || operation.needs_body {
            body["required"] = true.into();
        }
        described["requestBody"] = body;
        schemas.push((name, schema));
    }
    described
}

/// Returns the description in a doc comment: its lines after the summary.
fn paragraphs(doc: &str) -> String {
    let (_, lines) = doc.split_once('\n').unwrap_or_default();
    let lines = lines.lines().map(|line| line.strip_prefix(' ').unwrap_or(line));
    lines.collect::<Vec<_>>().join("\n").trim().to_owned()
}

fn responses(operation: &Operation, schemas: &mut Schemas) -> Value {
    let mut responses = responses::references(operation.problems);
    for answer in (operation.contract.answers)(schemas) {
        let description = answer.description.unwrap_or(operation.answer);
        responses.insert(answer.status.to_string(), response(&answer, description));
        if let Some(creates) = operation.creates {
            responses.insert("201".to_owned(), response(&answer, creates));
        }
    }
    Value::Object(responses)
}

fn response(answer: &Answer, description: &str) -> Value {
    let mut response = json!({
        "description": description,
        "content": {"application/json": {"schema": reference(&answer.schema)}},
    });
    if let Some((name, description)) = answer.header {
        let header = json!({"description": description, "schema": {"type": "string"}});
        response["headers"] = Value::Object(Map::from_iter([(name.to_owned(), header)]));
    }
    response
}

fn reference(schema: &str) -> Value {
    json!({"$ref": format!("#/components/schemas/{schema}")})
}
