//! Tests of the page that need no browser.

use std::collections::BTreeSet;

use axum::body::Body;
use axum::http::header::{ETAG, IF_NONE_MATCH};
use axum::http::{Request, Response};
use http_body_util::BodyExt;
use serde_json::Value;
use tower::ServiceExt;

use super::*;

async fn get(path: &str, known: Option<&HeaderValue>) -> Response<Body> {
    let mut request = Request::get(path);
    if let Some(known) = known {
        request = request.header(IF_NONE_MATCH, known);
    }
    page::<()>().oneshot(request.body(Body::empty()).unwrap()).await.unwrap()
}

async fn text(response: Response<Body>) -> String {
    String::from_utf8(response.into_body().collect().await.unwrap().to_bytes().to_vec()).unwrap()
}

fn header(response: &Response<Body>, name: HeaderName) -> String {
    response.headers().get(name).map(|value| value.to_str().unwrap().to_owned()).unwrap_or_default()
}

#[tokio::test]
async fn page_is_revalidated_by_its_etag() {
    let first = get("/", None).await;
    assert_eq!(first.status(), 200);
    assert_eq!(header(&first, CACHE_CONTROL), "no-cache");
    assert!(!header(&first, CONTENT_SECURITY_POLICY).contains("unsafe"));
    let etag = first.headers().get(ETAG).unwrap().clone();
    let again = get("/", Some(&etag)).await;
    assert_eq!((again.status(), again.headers().get(ETAG)), (StatusCode::NOT_MODIFIED, Some(&etag)));
    assert_eq!(text(again).await, "");
    assert_eq!(get("/", Some(&HeaderValue::from_static("\"another\""))).await.status(), 200);
}

#[tokio::test]
async fn assets_of_the_page_exist_and_are_cached() {
    let page = text(get("/", None).await).await;
    let named: Vec<_> = page.split('"').filter(|text| text.starts_with("/assets/")).collect();
    let modules = Assets::iter().filter(|path| is_first(path)).count();
    assert!(named.len() > modules, "{named:?}");
    for path in named {
        let part = get(path, None).await;
        assert_eq!(part.status(), 200, "{path}");
        assert!(header(&part, CACHE_CONTROL).ends_with("immutable"), "{path}");
        assert_ne!(header(&part, CONTENT_TYPE), "application/octet-stream", "{path}");
    }
    assert!(!page.contains("style=") && !page.contains("<script>") && !page.contains("://"), "{page}");
}

#[tokio::test]
async fn missing_or_outdated_asset_is_a_problem() {
    let other = format!("/assets/{}/app.js", "0".repeat(VERSION_DIGITS));
    let missing = format!("/assets/{}/none.js", version());
    let above = format!("/assets/{}/..%2Fmod.rs", version());
    for path in [other, missing, above] {
        let response = get(&path, None).await;
        assert_eq!(header(&response, CONTENT_TYPE), "application/problem+json", "{path}");
        assert_eq!(response.status(), 404, "{path}");
    }
}

#[test]
fn libraries_match_their_record_and_have_licences() {
    let recorded = Assets::get("vendor/vendored.json").unwrap();
    let recorded: Vec<Value> = serde_json::from_slice(&recorded.data).unwrap();
    let mut files = BTreeSet::new();
    for library in &recorded {
        let file = format!("vendor/{}", library["file"].as_str().unwrap());
        let hash = hex::encode(Sha256::digest(&Assets::get(&file).unwrap().data));
        assert_eq!(hash, library["sha256"], "{file} is not what tests/browser/vendor wrote");
        let licence = library["package"].as_str().unwrap().trim_start_matches('@').replace('/', "-");
        files.extend([file, format!("vendor/LICENSE-{licence}")]);
    }
    files.insert("vendor/vendored.json".to_owned());
    let present = Assets::iter().filter(|path| path.starts_with("vendor/")).map(Cow::into_owned).collect();
    assert_eq!(files, present);
}

const MAX_LINES: usize = 250;

#[test]
fn modules_are_short_and_import_only_served_files() {
    for path in Assets::iter().filter(|path| is_module(path) && !path.starts_with("vendor/")) {
        let module = String::from_utf8(Assets::get(&path).unwrap().data.into_owned()).unwrap();
        let lines = module.lines().count();
        assert!(lines <= MAX_LINES || path.starts_with("locales/"), "{path} has {lines} lines: split it");
        assert!(!module.contains("innerHTML") && !module.contains("eval("), "{path}");
        for import in module.lines().filter(|line| line.starts_with("import ") || line.starts_with("} from ")) {
            let Some((_, from)) = import.split_once('\'') else { continue };
            assert!(from.starts_with("./") || from.starts_with("../"), "{path}: {import}");
        }
    }
}

/// Paths of the modules that a module imports statically.
fn imported_by(path: &str) -> Vec<String> {
    let module = String::from_utf8(Assets::get(path).unwrap().data.into_owned()).unwrap();
    let address = url::Url::parse(&format!("http://gateway/{path}")).unwrap();
    let from = module.lines().filter_map(|line| {
        let is_import = ["import ", "export ", "} from "].iter().any(|word| line.starts_with(word));
        is_import.then_some(line)?.split_once(" from '")?.1.split_once('\'').map(|(from, _)| from)
    });
    from.map(|from| address.join(from).unwrap().path().trim_start_matches('/').to_owned()).collect()
}

#[test]
fn page_preloads_exactly_the_first_modules() {
    // The minified libraries write imports differently.
    let is_ours = |path: &str| !path.starts_with("vendor/");
    let mut needed = BTreeSet::new();
    let mut to_read = vec!["app.js".to_owned()];
    while let Some(path) = to_read.pop() {
        if needed.insert(path.clone()) {
            to_read.extend(imported_by(&path).into_iter().filter(|path| is_ours(path)));
        }
    }
    let named = Assets::iter().filter(|path| is_first(path) && is_ours(path)).map(Cow::into_owned).collect();
    assert_eq!(needed, named);
}
