//! The OpenAPI document, and the page that shows it: all of it from this program, for cells without internet.

use std::sync::{Arc, OnceLock};

use axum::Extension;
use axum::body::Bytes;
use axum::extract::{Path, Request};
use axum::http::header::{CACHE_CONTROL, CONTENT_ENCODING, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderValue};
use axum::response::{Html, IntoResponse, Response};
use axum::{Router, routing};
use utoipa::OpenApi as _;
use utoipa::openapi::{OpenApi, RefOr, Schema};

use super::asyncapi as websocket;
use super::paths::responses;
use crate::journal::{EventKind, Order};
use crate::operations::{Members, Problem};

/// What the document says before its operations.
#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "WSG Gateway",
        description = "Lets many clients share Weiss/SCHUNK WSG grippers.\n\n\
            Bodies are read as JSON whatever their Content-Type; nothing at all is `{}`. Units are in the names. \
            What the device refuses is a problem (RFC 9457) with a stable `code`; what it accepted is a command with \
            an `outcome`. FAST STOP is not a safety function in the sense of ISO 13850.",
        license(name = "MIT", identifier = "MIT"),
        contact(),
    ),
    tags(
        (name = "grippers", description = "What the gateway knows: costs the device nothing"),
        (name = "motion", description = "What moves the fingers, and what stops them"),
        (name = "fast stop", description = "The stop that holds until it is acknowledged by its id"),
        (name = "commands", description = "What became of a request"),
        (name = "lease", description = "Who may move a gripper, and what becomes of it when that client is lost"),
        (name = "fleet", description = "All grippers of all gateways on the Zenoh network"),
        (name = "settings", description = "What the device keeps until it restarts, and its tag"),
        (name = "device", description = "What else the manual has"),
        (name = "journal", description = "What happened, and how parts were held"),
        (name = "gateway", description = "The gateway itself"),
    ),
    components(schemas(Members, EventKind, Order)),
)]
struct Document;

/// The document without its operations.
pub fn base() -> OpenApi {
    let mut document = Document::openapi();
    responses::describe(document.components.get_or_insert_default());
    document
}

/// Says of optional bodies that they may be left out, not that they may be `null`.
pub fn without_null_bodies(document: &mut OpenApi) {
    let bodies = document.paths.paths.values_mut().flat_map(|item| [&mut item.put, &mut item.post, &mut item.delete]);
    for body in bodies.flatten().filter_map(|operation| operation.request_body.as_mut()) {
        let RefOr::T(body) = body else { continue };
        for content in body.content.values_mut() {
            let RefOr::T(content) = content else { continue };
            if let Some(RefOr::T(Schema::OneOf(or_null))) = &content.schema {
                content.schema = or_null.items.iter().find(|item| matches!(item, RefOr::Ref(_))).cloned();
            }
        }
    }
}

/// The OpenAPI document
#[utoipa::path(
    get, path = "/openapi.json", operation_id = "openapi", tag = "gateway",
    responses((status = 200, description = "This document", body = serde_json::Value), responses::AnyProblem)
)]
pub async fn openapi(Extension(documents): Extension<Arc<Documents>>) -> impl IntoResponse {
    ([(CONTENT_TYPE, "application/json")], documents.openapi())
}

/// The AsyncAPI document
///
/// Of the WebSocket.
#[utoipa::path(
    get, path = "/asyncapi.yaml", operation_id = "asyncapi", tag = "gateway",
    responses((status = 200, description = "The document", body = serde_json::Value, content_type = "application/yaml"), responses::AnyProblem)
)]
pub async fn asyncapi(Extension(documents): Extension<Arc<Documents>>) -> impl IntoResponse {
    ([(CONTENT_TYPE, "application/yaml")], documents.asyncapi())
}

/// The API's documents, made once: all who ask for one share its bytes.
pub struct Documents {
    openapi: OpenApi,
    openapi_json: OnceLock<Bytes>,
    asyncapi_yaml: OnceLock<Bytes>,
}

impl Documents {
    /// The documents, of which this is one.
    pub fn new(openapi: OpenApi) -> Self {
        Self { openapi, openapi_json: OnceLock::new(), asyncapi_yaml: OnceLock::new() }
    }

    fn openapi(&self) -> Bytes {
        let json = || serde_json::to_vec(&self.openapi).unwrap_or_default().into();
        self.openapi_json.get_or_init(json).clone()
    }

    /// The AsyncAPI document as YAML.
    fn asyncapi(&self) -> Bytes {
        self.asyncapi_yaml.get_or_init(|| websocket::yaml(&self.openapi).unwrap_or_default().into()).clone()
    }
}

/// The page. Its addresses are absolute, since there is no redirect that would add a slash to its own.
const PAGE: &str = r#"<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>WSG Gateway: HTTP API</title>
<link rel="stylesheet" href="/docs/swagger-ui.css">
<link rel="icon" type="image/png" href="/docs/favicon-32x32.png">
</head>
<body>
<div id="swagger-ui"></div>
<script src="/docs/swagger-ui-bundle.js"></script>
<script src="/docs/start.js"></script>
</body>
</html>
"#;

const START: &str = r##"window.ui = SwaggerUIBundle({
  url: "/api/v1/openapi.json",
  dom_id: "#swagger-ui",
  deepLinking: true,
  displayRequestDuration: true,
  validatorUrl: null,
});
"##;

/// Everything from here and nowhere else. The styles are the exception: Swagger UI sets some on its elements.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; font-src 'self' \
     data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

/// The page and its parts.
pub fn page<S: Clone + Send + Sync + 'static>() -> Router<S> {
    Router::new()
        .route("/docs", routing::get(async || ([(CONTENT_SECURITY_POLICY, POLICY)], Html(PAGE))))
        .route("/docs/start.js", routing::get(async || ([(CONTENT_TYPE, "text/javascript")], START)))
        .route("/docs/{file}", routing::get(part))
}

async fn part(Path(file): Path<String>, _: Request) -> Response {
    let config = Arc::new(utoipa_swagger_ui::Config::default());
    // Those that the page needs; the rest of the distribution is of no use here.
    let served = matches!(file.as_str(), "swagger-ui.css" | "swagger-ui-bundle.js" | "favicon-32x32.png");
    match served.then(|| utoipa_swagger_ui::serve(&file, config)) {
        Some(Ok(Some(file))) => {
            let mut response = ([(CONTENT_TYPE, file.content_type)], file.bytes).into_response();
            let headers = response.headers_mut();
            headers.insert(CACHE_CONTROL, HeaderValue::from_static("max-age=3600"));
            if file.gzpipped {
                headers.insert(CONTENT_ENCODING, HeaderValue::from_static("gzip"));
            }
            response
        }
        _ => Problem::not_found("such path").into_response(),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    #[test]
    fn the_checked_in_document_is_what_is_served() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi/openapi.json");
        let served = serde_json::to_string_pretty(&crate::interfaces::http::openapi()).unwrap() + "\n";
        assert!(
            fs::read_to_string(path).unwrap_or_default() == served,
            "openapi/openapi.json is stale: cargo run -- openapi > openapi/openapi.json"
        );
    }
}
