//! The guides of `deploy/guide`, rendered as pages below `/docs/guide`.
//!
//! The pages are part of the program, because a cell may have no internet. A page is rendered when it is first asked for.

mod page;

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::Path;
use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderValue, LOCATION};
use axum::response::{Html, IntoResponse, Response};
use axum::{Router, routing};
use rust_embed::Embed;

use crate::interfaces::on_demand::OnDemand;
use crate::operations::Problem;
use page::INDEX;

/// The guides, and the files next to them that the guides link to.
#[derive(Embed)]
#[folder = "deploy"]
struct Files;

const STYLE: &str = include_str!("style.css");

const SCRIPT: &str = include_str!("page.js");

/// The pages load their style, their script and the text for the search from here, and nothing else from anywhere.
pub const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; style-src 'self'; script-src 'self'; connect-src 'self'; img-src 'self'; base-uri 'none'; \
     form-action 'none'; frame-ancestors 'none'",
);

/// A browser asks each time whether the gateway has another version.
pub const CACHING: HeaderValue = HeaderValue::from_static("no-cache");

/// Returns the routes of the guides.
pub fn pages<S: Clone + Send + Sync + 'static>() -> Router<S> {
    let guides = Arc::new(Guides::default());
    let index = guides.clone();
    let index = routing::get(async move || index.page(INDEX).await);
    let search = Arc::new(OnDemand::new(searched));
    Router::new()
        // The links of the pages are relative, so that a proxy can serve them below any path.
        .route("/docs/guide", routing::get(async || (StatusCode::TEMPORARY_REDIRECT, [(LOCATION, "guide/")])))
        .route("/docs/guide/", index)
        .route("/docs/guide/style.css", routing::get(async || part("text/css", STYLE.into())))
        .route("/docs/guide/page.js", routing::get(async || part("text/javascript", SCRIPT.into())))
        .route(
            "/docs/guide/search.json",
            routing::get(async move || Ok::<_, Problem>(part("application/json", search.get().await?.clone()))),
        )
        .route("/docs/guide/{name}", routing::get(async move |Path(name): Path<String>| guides.page(&name).await))
        .route("/docs/files/{*path}", routing::get(async |Path(path): Path<String>| file(&path)))
}

/// The rendered pages by name, without `.md`.
struct Guides(BTreeMap<String, OnDemand<Bytes>>);

impl Default for Guides {
    fn default() -> Self {
        Self(names().map(|name| (name.clone(), OnDemand::new(move || rendered(&name).into()))).collect())
    }
}

impl Guides {
    async fn page(&self, name: &str) -> Result<Response, Problem> {
        let name = name.strip_suffix(".md").unwrap_or(name);
        let page = self.0.get(name).ok_or_else(|| Problem::not_found("such guide"))?;
        let html = Html(page.get().await?.clone());
        Ok(([(CONTENT_SECURITY_POLICY, POLICY), (CACHE_CONTROL, CACHING)], html).into_response())
    }
}

fn rendered(name: &str) -> String {
    page::rendered(name, &markdown(name)).unwrap_or_default()
}

/// Returns the sections of all guides as JSON.
fn searched() -> Bytes {
    let sections: Vec<_> = names().flat_map(|name| page::sections(&name, &markdown(&name))).collect();
    serde_json::to_vec(&sections).unwrap_or_default().into()
}

/// Returns the names of all guides, without `.md`.
fn names() -> impl Iterator<Item = String> {
    Files::iter().filter_map(|path| Some(path.strip_prefix("guide/")?.strip_suffix(".md")?.to_owned()))
}

fn markdown(name: &str) -> String {
    text(&format!("guide/{name}.md")).unwrap_or_default()
}

/// Serves a part of the pages.
fn part(content_type: &'static str, content: Bytes) -> Response {
    ([(CONTENT_TYPE, HeaderValue::from_static(content_type)), (CACHE_CONTROL, CACHING)], content).into_response()
}

/// Serves a file that a guide links to. Text is shown as it is, never run.
fn file(path: &str) -> Response {
    match text(path) {
        Some(text) => ([(CONTENT_TYPE, "text/plain; charset=utf-8")], text).into_response(),
        None => Problem::not_found("such file").into_response(),
    }
}

fn text(path: &str) -> Option<String> {
    Files::get(path).map(|file| String::from_utf8_lossy(&file.data).into_owned())
}

#[cfg(test)]
mod tests {
    /// A promise about the future is an intention. Only what a test pins can be stated as a fact.
    #[test]
    fn promises_about_the_future_are_intentions() {
        let guide = include_str!("../../../../../deploy/guide/compatibility.md").replace('\n', " ");
        let sentences: Vec<_> = guide.split(". ").collect();
        for promise in ["`/api/v1` beside", "limit of a value"] {
            let found = sentences.iter().find(|sentence| sentence.contains(promise));
            assert!(found.is_some_and(|sentence| sentence.contains("We intend to")), "{promise}: {found:?}");
        }
        for absolute in ["never", "guarantee", "forever", "would continue"] {
            let found =
                sentences.iter().find(|sentence| sentence.contains(absolute) && !sentence.contains("Base decisions"));
            assert_eq!(found, None, "a promise that cannot be kept");
        }
    }
}
