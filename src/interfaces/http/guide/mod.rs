//! The guides of `deploy/guide`, rendered as pages below `/docs/guide`.
//!
//! The pages are part of the program, because a cell may have no internet. A page is rendered when it is first asked for.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::Path;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderValue};
use axum::response::{Html, IntoResponse, Response};
use axum::{Router, routing};
use comrak::Options;
use rust_embed::Embed;

use crate::interfaces::on_demand::OnDemand;
use crate::operations::Problem;

/// The guides, and the files next to them that the guides link to.
#[derive(Embed)]
#[folder = "deploy"]
struct Files;

/// The page that lists the others.
const INDEX: &str = "README";

const STYLE: &str = include_str!("style.css");

/// The pages load their style from here and nothing else from anywhere.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; style-src 'self'; img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

/// Returns the routes of the guides.
pub fn pages<S: Clone + Send + Sync + 'static>() -> Router<S> {
    let guides = Arc::new(Guides::default());
    let index = guides.clone();
    let index = routing::get(async move || index.page(INDEX).await);
    Router::new()
        .route("/docs/guide", index.clone())
        .route("/docs/guide/", index)
        .route("/docs/guide/style.css", routing::get(async || ([(CONTENT_TYPE, "text/css")], STYLE)))
        .route("/docs/guide/{name}", routing::get(async move |Path(name): Path<String>| guides.page(&name).await))
        .route("/docs/files/{*path}", routing::get(async |Path(path): Path<String>| file(&path)))
}

/// The rendered pages by name, without `.md`.
struct Guides(BTreeMap<String, OnDemand<Bytes>>);

impl Default for Guides {
    fn default() -> Self {
        let names = Files::iter().filter_map(|path| Some(path.strip_prefix("guide/")?.strip_suffix(".md")?.to_owned()));
        Self(names.map(|name| (name.clone(), OnDemand::new(move || rendered(&name).into()))).collect())
    }
}

impl Guides {
    async fn page(&self, name: &str) -> Result<Response, Problem> {
        let name = name.strip_suffix(".md").unwrap_or(name);
        let page = self.0.get(name).ok_or_else(|| Problem::not_found("such guide"))?;
        let html = Html(page.get().await?.clone());
        let caching = HeaderValue::from_static("no-cache");
        Ok(([(CONTENT_SECURITY_POLICY, POLICY), (CACHE_CONTROL, caching)], html).into_response())
    }
}

fn rendered(name: &str) -> String {
    let markdown = text(&format!("guide/{name}.md")).unwrap_or_default();
    let title = markdown.lines().next().unwrap_or_default().trim_start_matches('#').trim();
    let body = comrak::markdown_to_html(&markdown, &options());
    format!(
        r#"<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title} · WSG Gateway</title>
<link rel="stylesheet" href="/docs/guide/style.css">
</head>
<body>
<nav><a href="/docs/guide">Guides</a> <a href="/docs">HTTP API</a> <a href="/">Dashboard</a></nav>
<main>
{body}</main>
</body>
</html>
"#
    )
}

/// Returns the extensions that the guides use, with anchors as GitHub makes them.
fn options() -> Options<'static> {
    let mut options = Options::default();
    options.extension.table = true;
    options.extension.header_id_prefix = Some(String::new());
    options.extension.link_url_rewriter = Some(Arc::new(|link: &str| served_at(link)));
    options
}

/// Returns where the target of a link between the files of `deploy` is served.
fn served_at(link: &str) -> String {
    let (path, anchor) = link.split_at(link.find('#').unwrap_or(link.len()));
    if let Some(file) = path.strip_prefix("../") {
        return format!("/docs/files/{file}");
    }
    match path.strip_suffix(".md") {
        Some(INDEX) => format!("/docs/guide{anchor}"),
        Some(name) if !name.contains('/') => format!("/docs/guide/{name}{anchor}"),
        _ => link.to_owned(),
    }
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
        let guide = include_str!("../../../../deploy/guide/compatibility.md").replace('\n', " ");
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
