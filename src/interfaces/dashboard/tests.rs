//! Tests of the page that need no browser.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::io::Read as _;

use axum::body::Body;
use axum::http::header::{ETAG, IF_NONE_MATCH};
use axum::http::{Request, Response};
use http_body_util::BodyExt;
use serde_json::Value;
use tower::ServiceExt;

use super::*;

fn served(ancestors: &[String]) -> Router {
    page().layer(Extension(DashboardPolicy::of(ancestors).unwrap()))
}

async fn get(path: &str, known: Option<&HeaderValue>) -> Response<Body> {
    let mut request = Request::get(path);
    if let Some(known) = known {
        request = request.header(IF_NONE_MATCH, known);
    }
    served(&[]).oneshot(request.body(Body::empty()).unwrap()).await.unwrap()
}

async fn body(response: Response<Body>) -> String {
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
    assert_eq!(body(again).await, "");
    assert_eq!(get("/", Some(&HeaderValue::from_static("\"another\""))).await.status(), 200);
}

#[tokio::test]
async fn only_configured_pages_can_frame_the_page() {
    let policy = async |origins: &[String]| {
        let request = Request::get("/").body(Body::empty()).unwrap();
        header(&served(origins).oneshot(request).await.unwrap(), CONTENT_SECURITY_POLICY)
    };
    assert!(policy(&[]).await.contains("frame-ancestors 'none';"));
    let allowed = policy(&["https://hmi.example".to_owned(), "http://10.0.0.5:8000".to_owned()]).await;
    assert!(allowed.contains("frame-ancestors https://hmi.example http://10.0.0.5:8000;"), "{allowed}");
}

#[tokio::test]
async fn assets_of_the_page_exist_and_are_cached() {
    let page = body(get("/", None).await).await;
    let named: Vec<_> = page.split('"').filter(|text| text.starts_with("assets/")).collect();
    assert_eq!(named.len(), 4, "{named:?}");
    for path in named {
        let part = get(&format!("/{path}"), None).await;
        assert_eq!(part.status(), 200, "{path}");
        assert!(header(&part, CACHE_CONTROL).ends_with("immutable"), "{path}");
        assert_ne!(header(&part, CONTENT_TYPE), "application/octet-stream", "{path}");
    }
    assert!(!page.contains("style=") && !page.contains("<script>") && !page.contains("://"), "{page}");
}

#[tokio::test]
async fn page_works_below_any_path() {
    let page = body(get("/", None).await).await;
    assert!(!page.contains("=\"/"), "an absolute link: {page}");
    let manifest: Value = serde_json::from_str(&text("manifest.webmanifest")).unwrap();
    let at = url::Url::parse(&format!("http://plant/left/assets/{}/manifest.webmanifest", version())).unwrap();
    for member in ["start_url", "scope"] {
        let target = at.join(manifest[member].as_str().unwrap()).unwrap();
        assert_eq!(target.as_str(), "http://plant/left/", "{member}");
    }
    for path in Assets::iter().filter(|path| is_module(path) && !path.starts_with("vendor/")) {
        let module = text(&path);
        for absolute in ["href=\"/", "'/api/", "`/api/", "}/api/", "location.host}"] {
            assert!(!module.contains(absolute), "{path} has {absolute}: a proxy can serve the page below a path");
        }
    }
}

#[tokio::test]
async fn default_check_of_haproxy_is_answered() {
    let request = Request::options("/").body(Body::empty()).unwrap();
    let response = served(&[]).oneshot(request).await.unwrap();
    assert_eq!(response.status(), StatusCode::NO_CONTENT);
    assert_eq!(header(&response, ALLOW), "GET, HEAD, OPTIONS");
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

fn is_module(path: &str) -> bool {
    std::path::Path::new(path).extension().is_some_and(|extension| extension == "js")
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

/// All modules that one needs, with those that it imports later.
fn needed_by(path: &str, needed: &mut BTreeSet<String>) {
    if !needed.insert(path.to_owned()) {
        return;
    }
    let address = url::Url::parse(&format!("http://gateway/{path}")).unwrap();
    // The minified libraries quote otherwise.
    for from in text(path).split(['\'', '"']).filter(|part| part.starts_with('.') && is_module(part)) {
        needed_by(address.join(from).unwrap().path().trim_start_matches('/'), needed);
    }
}

#[test]
fn scripts_have_every_module_once() {
    let mut needed = BTreeSet::from(["net/early.js".to_owned()]);
    needed_by(FIRST, &mut needed);
    let present: BTreeSet<_> = Assets::iter().filter(|path| is_module(path)).map(Cow::into_owned).collect();
    assert_eq!(needed, present);
    let files = joined();
    let script =
        [FIRST, SECOND, PLOTS, VIEWS].map(|path| String::from_utf8(files[path].plain.to_vec()).unwrap()).concat();
    // Variables with a value belong to the block of one module.
    let declared = script.lines().filter(|line| !line.contains('='));
    let declared = declared.filter_map(|line| line.strip_prefix("let ")?.strip_suffix(';'));
    let mut exports: Vec<_> = declared.flat_map(|names| names.split(", ")).collect();
    assert!(exports.len() > 200 && exports.contains(&"fastStop") && exports.contains(&"Motion"));
    let count = exports.len();
    exports.sort_unstable();
    exports.dedup();
    assert_eq!(exports.len(), count, "an exported name needs to be unique among all modules");
    // A script cannot redeclare these properties of the window.
    assert!(["window", "document", "location", "top"].iter().all(|name| !exports.contains(name)));
    for line in script.lines() {
        let is_import = line.starts_with("import ") && !line.ends_with(&format!(" from './{SECOND}';"));
        assert!(!is_import && !line.starts_with("export function"), "{line}");
    }
}

#[tokio::test]
async fn scripts_are_compressed_for_clients_that_take_it() {
    let path = format!("/assets/{}/{FIRST}", version());
    let plain = body(get(&path, None).await).await;
    for (coding, is_compressed) in [("gzip, deflate, br", true), ("br", false), ("gzip;q=0", false)] {
        let request = Request::get(&path).header(ACCEPT_ENCODING, coding).body(Body::empty()).unwrap();
        let response = served(&[]).oneshot(request).await.unwrap();
        assert_eq!(header(&response, CONTENT_ENCODING), if is_compressed { "gzip" } else { "" }, "{coding}");
        assert_eq!(header(&response, VARY), "accept-encoding");
        let bytes = response.into_body().collect().await.unwrap().to_bytes();
        if is_compressed {
            // At 400 kbit/s, each kilobyte delays the first screen by 20 ms.
            assert!(bytes.len() < 48_000, "{}", bytes.len());
            let mut text = String::new();
            flate2::read::GzDecoder::new(&*bytes).read_to_string(&mut text).unwrap();
            assert_eq!(text, plain);
        }
    }
}
