//! The OpenAPI document and the page that shows it. Both are part of this program, for sites without internet access.

use std::sync::Arc;

use axum::extract::{Path, Request};
use axum::http::header::{CACHE_CONTROL, CONTENT_ENCODING, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderValue};
use axum::response::{Html, IntoResponse, Response};
use axum::{Router, routing};
use utoipa::OpenApi as _;
use utoipa::openapi::security::{ApiKey, ApiKeyValue, HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa::openapi::{OpenApi, RefOr, Schema};

use super::paths::responses;
use crate::interfaces::http::http_settings::HttpSettings;
use crate::interfaces::http::requests::visitor::cookie_name;
use crate::journal::{EventKind, Order};
use crate::operations::records::GripKinds;
use crate::operations::statistics::MeasuredGrips;
use crate::operations::{Members, Problem};

/// Paths of the API's documents.
pub const DOCUMENTS: [&str; 2] = ["/openapi.json", "/asyncapi.yaml"];

/// The OpenAPI document.
pub const OPENAPI: &str = include_str!("../../../../openapi/openapi.json");

/// The AsyncAPI document of the WebSocket, as YAML.
pub const ASYNCAPI: &str = include_str!("../../../../openapi/asyncapi.yaml");

/// Head of the OpenAPI document: title, description and tags.
#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "WSG Gateway",
        description = "Lets many clients share Weiss/SCHUNK WSG grippers.\n\n\
            Bodies are read as JSON whatever their Content-Type; an empty body or `null` means `{}`, and an optional \
            field that is `null` counts as absent. Field names include their units. A refused request returns a problem \
            (RFC 9457) with a stable `code`; a motion that the device accepts returns a command with an `outcome`. FAST \
            STOP is not a safety function in the sense of ISO 13850.",
        license(name = "MIT", identifier = "MIT"),
        contact(),
    ),
    tags(
        (name = "grippers", description = "Grippers and their states, served without querying the device"),
        (name = "motion", description = "Move the fingers, and stop them"),
        (name = "servo", description = "Steer the fingers by targets many times a second"),
        (name = "fast stop", description = "A stop that blocks all motion until it is acknowledged by its id"),
        (name = "commands", description = "Progress and outcome of commands"),
        (name = "lease", description = "The right to move a gripper, and the reaction if the lease holder is lost"),
        (name = "fleet", description = "All grippers of all gateways on the Zenoh network"),
        (name = "alarms", description = "Conditions that a person must know about, until they are acknowledged"),
        (name = "recipes", description = "Stored grip and release values, by part id or number"),
        (name = "settings", description = "Settings that the device keeps until it restarts, and its permanent tag"),
        (name = "device", description = "Other device commands: statistics, fingers, tare, Loop, raw requests"),
        (name = "journal", description = "Events and grip records, stored and live"),
        (name = "webhooks", description = "Deliveries of events to other programs"),
        (name = "gateway", description = "Health, metrics and API documents of the gateway itself"),
    ),
    components(schemas(Members, EventKind, GripKinds, MeasuredGrips, Order)),
    servers((url = "/", description = "The gateway that serves this document")),
    // A gateway on loopback needs no credentials.
    security((), ("token" = []), ("session" = [])),
)]
struct Document;

/// Returns the document without its operations.
pub fn base() -> OpenApi {
    let mut document = Document::openapi();
    let components = document.components.get_or_insert_default();
    responses::describe(components);
    let token = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some("A token of the gateway")).build();
    components.add_security_scheme("token", SecurityScheme::Http(token));
    let name = cookie_name(&HttpSettings::default());
    let description = "A session of a browser, which `sign_in` begins. The name ends with the gateway's port, and begins \
                       with `__Host-` over TLS";
    let session = ApiKeyValue::with_description(name, description.to_owned());
    components.add_security_scheme("session", SecurityScheme::ApiKey(ApiKey::Cookie(session)));
    document
}

/// Marks optional bodies as omittable instead of nullable, because code generators handle that better. A body of `null` is
/// accepted nevertheless.
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

/// Get the OpenAPI document
#[utoipa::path(
    get, path = "/openapi.json", operation_id = "openapi", tag = "gateway",
    responses((status = 200, description = "This document", body = serde_json::Value), responses::AnyProblem)
)]
pub async fn openapi() -> impl IntoResponse {
    ([(CONTENT_TYPE, "application/json")], OPENAPI)
}

/// Get the AsyncAPI document
///
/// Describes the WebSocket interface.
#[utoipa::path(
    get, path = "/asyncapi.yaml", operation_id = "asyncapi", tag = "gateway",
    responses((status = 200, description = "The document", body = serde_json::Value, content_type = "application/yaml"), responses::AnyProblem)
)]
pub async fn asyncapi() -> impl IntoResponse {
    ([(CONTENT_TYPE, "application/yaml")], ASYNCAPI)
}

/// The API page. Its links are relative to `/docs`, so that a proxy can serve it below any path.
const PAGE: &str = r#"<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>WSG Gateway: HTTP API</title>
<link rel="stylesheet" href="docs/swagger-ui.css">
<link rel="icon" type="image/png" href="docs/favicon-32x32.png">
</head>
<body>
<div id="swagger-ui"></div>
<script src="docs/swagger-ui-bundle.js"></script>
<script src="docs/start.js"></script>
</body>
</html>
"#;

/// Script of the API page. Requests go to the address of the page, because the document cannot know the path below which
/// a proxy serves it.
const START: &str = r##"fetch("api/v1/openapi.json").then((response) => response.json()).then((spec) => {
  const { href } = new URL(".", location.href);
  window.ui = SwaggerUIBundle({
    spec: { ...spec, servers: [{ url: href.slice(0, -1), description: "This gateway" }] },
    dom_id: "#swagger-ui",
    deepLinking: true,
    displayRequestDuration: true,
    validatorUrl: null,
  });
});
"##;

/// Policy that allows content from this gateway only. Inline styles are allowed because Swagger UI sets them.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; font-src 'self' \
     data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

/// Returns the routes of the page and its assets.
pub fn page<S: Clone + Send + Sync + 'static>() -> Router<S> {
    Router::new()
        .route("/docs", routing::get(async || ([(CONTENT_SECURITY_POLICY, POLICY)], Html(PAGE))))
        .route("/docs/start.js", routing::get(async || ([(CONTENT_TYPE, "text/javascript")], START)))
        .route("/docs/{file}", routing::get(part))
}

async fn part(Path(file): Path<String>, _: Request) -> Response {
    let config = Arc::new(utoipa_swagger_ui::Config::default());
    // Only the files that the page needs, out of the whole distribution.
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
