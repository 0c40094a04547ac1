//! The dashboard: a page embedded in the program, which uses only the public WebSocket and REST interfaces.
//!
//! There is no build step: when a browser first loads the page, the gateway joins the modules into four scripts and the
//! styles into one, and compresses them. Their paths contain a hash of all assets, so that a browser caches them until
//! one changes, and asks only for the page. The content security policy allows no other origin, and no inline script or
//! style.
//! `tests/browser/vendor` fetches the libraries in `vendor/`.

mod bundle;

use std::collections::BTreeMap;
use std::io::Write as _;
use std::sync::Arc;

use axum::body::Body;
use axum::extract::Path;
use axum::http::header::InvalidHeaderValue;
use axum::http::header::{
    ACCEPT_ENCODING, ALLOW, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderMap,
    HeaderValue, VARY,
};
use axum::http::{HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Router, routing};
use bytes::Bytes;
use flate2::Compression;
use flate2::write::GzEncoder;
use headers::{ETag, HeaderMapExt, IfNoneMatch};
use rust_embed::{Embed, EmbeddedFile};
use sha2::{Digest, Sha256};

use crate::interfaces::on_demand::OnDemand;
use crate::operations::Problem;
use bundle::Bundle;

#[derive(Embed)]
#[folder = "src/interfaces/dashboard/assets"]
struct Assets;

/// The page. `{version}` in it stands for the hash of the assets.
const PAGE: &str = "index.html";

/// Module that the first screen needs, module that the page imports after it, module of the library that draws plots,
/// which the page imports last, and module of the views that are opened less often.
const FIRST: &str = "app.js";
const SECOND: &str = "later.js";
const PLOTS: &str = "plots.js";
const VIEWS: &str = "views.js";

/// Style sheets, in order.
const STYLES: [&str; 5] =
    ["style/tokens.css", "style/layout.css", "style/controls.css", "style/panels.css", "vendor/uplot.css"];

/// Content security policy of the page: only this origin, without inline code or forms, and in no frame of another page
/// unless the configuration names that page's origin.
#[derive(Debug, Clone)]
pub struct DashboardPolicy(HeaderValue);

impl Default for DashboardPolicy {
    /// Allows no frames.
    fn default() -> Self {
        Self::of(&[]).unwrap_or(Self(HeaderValue::from_static("default-src 'none'")))
    }
}

impl DashboardPolicy {
    /// Allows frames in pages of these origins.
    ///
    /// # Errors
    /// An origin that cannot be in a header.
    pub fn of(origins: &[String]) -> Result<Self, InvalidHeaderValue> {
        let ancestors = if origins.is_empty() { "'none'".to_owned() } else { origins.join(" ") };
        let policy = format!(
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
             manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors {ancestors}; \
             require-trusted-types-for 'script'"
        );
        policy.try_into().map(Self)
    }
}

/// Disables browser features that the page does not use.
const PERMISSIONS: (HeaderName, HeaderValue) = (
    HeaderName::from_static("permissions-policy"),
    HeaderValue::from_static("camera=(), geolocation=(), microphone=(), usb=(), serial=()"),
);

/// Hexadecimal digits of the hash in a path.
const VERSION_DIGITS: usize = 16;

/// A file in plain and, if that is smaller, compressed form.
struct Content {
    media_type: HeaderValue,
    plain: Bytes,
    gzip: OnDemand<Option<Bytes>>,
}

impl Content {
    fn new(media_type: &'static str, text: String) -> Self {
        let plain = Bytes::from(text);
        let uncompressed = plain.clone();
        let gzip = OnDemand::new(move || compressed(&uncompressed));
        Self { media_type: HeaderValue::from_static(media_type), plain, gzip }
    }

    /// Returns a response in a form that the client accepts.
    async fn response(&self, headers: &HeaderMap, caching: &'static str) -> Response {
        let accepts = headers.get(ACCEPT_ENCODING).and_then(|value| value.to_str().ok()).unwrap_or_default();
        let takes_gzip = accepts.split(',').any(|coding| coding.trim() == "gzip");
        let gzip = if takes_gzip { self.gzip.get().await.ok().and_then(Option::as_ref) } else { None };
        let body = gzip.unwrap_or(&self.plain).clone();
        let caching = HeaderValue::from_static(caching);
        let mut response = ([(CONTENT_TYPE, self.media_type.clone()), (CACHE_CONTROL, caching)], body).into_response();
        response.headers_mut().insert(VARY, HeaderValue::from_static("accept-encoding"));
        if gzip.is_some() {
            response.headers_mut().insert(CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        }
        response
    }
}

/// Compresses a file; returns none if that does not make it smaller.
fn compressed(plain: &[u8]) -> Option<Bytes> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(plain).ok()?;
    encoder.finish().ok().filter(|gzip| gzip.len() < plain.len()).map(Bytes::from)
}

/// Returns the files that the gateway joins from assets, by path.
fn joined() -> BTreeMap<&'static str, Content> {
    let first = Bundle::first(&text, FIRST);
    let second = first.module(&text, SECOND);
    let plots = second.module(&text, PLOTS);
    let views = second.module_after(&text, VIEWS, SECOND);
    let style = Content::new("text/css; charset=utf-8", without_comments(&STYLES.map(text).concat()));
    BTreeMap::from([
        (FIRST, script(&first)),
        (SECOND, script(&second)),
        (PLOTS, script(&plots)),
        (VIEWS, script(&views)),
        ("style.css", style),
    ])
}

/// Removes comments and indentation from a style sheet.
fn without_comments(style: &str) -> String {
    let mut kept = String::new();
    let mut rest = style;
    while let Some((before, after)) = rest.split_once("/*") {
        kept.push_str(before);
        rest = after.split_once("*/").map_or("", |(_, after)| after);
    }
    kept.push_str(rest);
    let lines = kept.lines().map(str::trim).filter(|line| !line.is_empty());
    lines.collect::<Vec<_>>().join("\n")
}

fn script(bundle: &Bundle) -> Content {
    Content::new("text/javascript; charset=utf-8", bundle.script().to_owned())
}

/// Returns the text of an asset; empty if the asset does not exist.
fn text(path: &str) -> String {
    Assets::get(path).map(|file| String::from_utf8_lossy(&file.data).into_owned()).unwrap_or_default()
}

/// Routes of the page and its assets.
pub fn page<S: Clone + Send + Sync + 'static>() -> Router<S> {
    let version: Arc<str> = version().into();
    let page = text(PAGE).replace("{version}", &version);
    let etag = format!("\"{}\"", hex::encode(Sha256::digest(page.as_bytes())));
    let page = Arc::new(Content::new("text/html; charset=utf-8", page));
    let files = Arc::new(OnDemand::new(joined));
    Router::new()
        .route(
            "/",
            routing::get(async move |policy: Extension<DashboardPolicy>, headers: HeaderMap| {
                index(&page, &etag, &policy, &headers).await
            })
            // HAProxy's default health check.
            .options(async || (StatusCode::NO_CONTENT, [(ALLOW, HeaderValue::from_static("GET, HEAD, OPTIONS"))])),
        )
        .route("/favicon.ico", routing::get(async || asset("icon.svg", "no-cache")))
        .route(
            "/assets/{version}/{*path}",
            routing::get(async move |Path((of, path)): Path<(String, String)>, headers: HeaderMap| {
                const CACHING: &str = "public, max-age=31536000, immutable";
                if *of != *version {
                    return Err(missing());
                }
                match files.get().await?.get(&*path) {
                    Some(file) => Ok(file.response(&headers, CACHING).await),
                    None => asset(&path, CACHING),
                }
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

async fn index(page: &Content, etag: &str, DashboardPolicy(policy): &DashboardPolicy, headers: &HeaderMap) -> Response {
    // A quoted hash is always a valid tag.
    let etag: Option<ETag> = etag.parse().ok();
    let is_known = etag
        .as_ref()
        .zip(headers.typed_get::<IfNoneMatch>())
        .is_some_and(|(etag, known)| !known.precondition_passes(etag));
    let mut response = page.response(headers, "no-cache").await;
    if is_known {
        *response.status_mut() = StatusCode::NOT_MODIFIED;
        *response.body_mut() = Body::empty();
        response.headers_mut().remove(CONTENT_TYPE);
        response.headers_mut().remove(CONTENT_ENCODING);
    }
    let headers = response.headers_mut();
    headers.insert(CONTENT_SECURITY_POLICY, policy.clone());
    let (name, permissions) = PERMISSIONS;
    headers.insert(name, permissions);
    if let Some(etag) = etag {
        headers.typed_insert(etag);
    }
    response
}

fn asset(path: &str, caching: &'static str) -> Result<Response, Problem> {
    let EmbeddedFile { data, metadata, .. } = Assets::get(path).ok_or_else(missing)?;
    let content_type = HeaderValue::from_str(metadata.mimetype());
    let content_type = content_type.unwrap_or(HeaderValue::from_static("application/octet-stream"));
    Ok(([(CONTENT_TYPE, content_type), (CACHE_CONTROL, HeaderValue::from_static(caching))], data).into_response())
}

fn missing() -> Problem {
    Problem::not_found("such part of the dashboard: load the page again")
}

#[cfg(test)]
mod tests;
