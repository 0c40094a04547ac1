//! The dashboard: a page embedded in the program, which uses only the public WebSocket and REST interfaces.
//!
//! Modules are served as written, without a build step. Their paths contain a hash of all of them, so that a browser
//! caches them until one changes, and asks only for the page. The content security policy allows no other origin, and
//! no inline script or style. `tests/browser/vendor` fetches the libraries in `vendor/`.

use std::borrow::Cow;
use std::sync::Arc;

use axum::extract::Path;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderMap, HeaderValue};
use axum::http::{HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::{Router, routing};
use headers::{ETag, HeaderMapExt, IfNoneMatch};
use rust_embed::{Embed, EmbeddedFile};
use sha2::{Digest, Sha256};

use crate::operations::Problem;

#[derive(Embed)]
#[folder = "src/interfaces/dashboard/assets"]
struct Assets;

/// The page. Serving it adds links to its modules.
const PAGE: &str = "index.html";

/// Assets without a preload link: the page loads them itself, most of them after the first screen.
const LATER: [&str; 5] = ["views/", "core/limits.js", "model/jog.js", "vendor/uplot.js", "net/early.js"];

/// Allows only this origin, without inline code, forms or embedding in a frame.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
     base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'",
);

/// Disables browser features that the page does not use.
const PERMISSIONS: (HeaderName, HeaderValue) = (
    HeaderName::from_static("permissions-policy"),
    HeaderValue::from_static("camera=(), geolocation=(), microphone=(), usb=(), serial=()"),
);

/// Hexadecimal digits of the hash in a path.
const VERSION_DIGITS: usize = 16;

/// Routes of the page and its assets.
pub fn page<S: Clone + Send + Sync + 'static>() -> Router<S> {
    let version: Arc<str> = version().into();
    let page: Arc<str> = with_modules(&version).into();
    let of_version = version.clone();
    Router::new()
        .route("/", routing::get(async move |headers: HeaderMap| index(&page, &headers)))
        .route("/favicon.ico", routing::get(async || asset("icon.svg", "no-cache")))
        .route(
            "/assets/{version}/{*path}",
            routing::get(async move |Path((version, path)): Path<(String, String)>| {
                if *version == *of_version { asset(&path, "public, max-age=31536000, immutable") } else { missing() }
            }),
        )
}

/// Returns a hash of all assets.
fn version() -> String {
    let mut files: Vec<_> = Assets::iter().collect();
    files.sort();
    let hash = files.iter().filter_map(|path| Some((path, Assets::get(path)?))).fold(
        Sha256::new(),
        |hash, (path, EmbeddedFile { data, .. })| {
            let size = (data.len() as u64).to_le_bytes();
            hash.chain_update(path.as_bytes()).chain_update([0]).chain_update(size).chain_update(data)
        },
    );
    let mut digits = hex::encode(hash.finalize());
    digits.truncate(VERSION_DIGITS);
    digits
}

/// Returns the page with the paths of its assets. The first modules get preload links, so that they load in parallel.
fn with_modules(version: &str) -> String {
    let page = Assets::get(PAGE).map(|file| String::from_utf8_lossy(&file.data).into_owned()).unwrap_or_default();
    let mut modules: Vec<_> = Assets::iter().filter(|path| is_first(path)).collect();
    modules.sort();
    let link = |path: &Cow<'static, str>| format!("<link rel=\"modulepreload\" href=\"/assets/{version}/{path}\">\n");
    let links: String = modules.iter().map(link).collect();
    page.replace("<!-- modules -->\n", &links).replace("{version}", version)
}

fn is_first(path: &str) -> bool {
    is_module(path) && !LATER.iter().any(|later| path.starts_with(later))
}

fn is_module(path: &str) -> bool {
    std::path::Path::new(path).extension().is_some_and(|extension| extension == "js")
}

fn index(page: &Arc<str>, headers: &HeaderMap) -> Response {
    // A quoted hash is always a valid tag.
    let etag: Option<ETag> = format!("\"{}\"", hex::encode(Sha256::digest(page.as_bytes()))).parse().ok();
    let is_known = etag
        .as_ref()
        .zip(headers.typed_get::<IfNoneMatch>())
        .is_some_and(|(etag, known)| !known.precondition_passes(etag));
    let mut response = if is_known {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        ([(CONTENT_TYPE, HeaderValue::from_static("text/html; charset=utf-8"))], page.to_string()).into_response()
    };
    let headers = response.headers_mut();
    headers.insert(CONTENT_SECURITY_POLICY, POLICY);
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    let (name, permissions) = PERMISSIONS;
    headers.insert(name, permissions);
    if let Some(etag) = etag {
        headers.typed_insert(etag);
    }
    response
}

fn asset(path: &str, caching: &'static str) -> Response {
    let Some(EmbeddedFile { data, metadata, .. }) = Assets::get(path) else { return missing() };
    let content_type = HeaderValue::from_str(metadata.mimetype());
    let content_type = content_type.unwrap_or(HeaderValue::from_static("application/octet-stream"));
    ([(CONTENT_TYPE, content_type), (CACHE_CONTROL, HeaderValue::from_static(caching))], data).into_response()
}

fn missing() -> Response {
    Problem::not_found("such part of the dashboard: load the page again").into_response()
}

#[cfg(test)]
mod tests;
