//! The wheel of the Python package, and a page that lists it, below `/python`.
//!
//! The wheel is part of the program, because a cell may have no internet, and because the package of the gateway's own
//! version fits it best. `deploy/python/generate.py` writes the wheel.

use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, LOCATION};
use axum::response::Html;
use axum::{Router, routing};

use super::guide::{CACHING, POLICY};

const WHEEL: &str = concat!("wsg_gateway-", env!("CARGO_PKG_VERSION"), "-py3-none-any.whl");

const CONTENT: &[u8] =
    include_bytes!(concat!("../../../../deploy/python/wsg_gateway-", env!("CARGO_PKG_VERSION"), "-py3-none-any.whl"));

/// Returns the routes of the page and the wheel. The page's links are relative, so that a proxy can serve it below any
/// path, and so that `pip install --find-links` finds the wheel.
pub fn files<S: Clone + Send + Sync + 'static>() -> Router<S> {
    Router::new()
        .route("/python", routing::get(async || (StatusCode::TEMPORARY_REDIRECT, [(LOCATION, "python/")])))
        .route(
            "/python/",
            routing::get(async || ([(CONTENT_SECURITY_POLICY, POLICY), (CACHE_CONTROL, CACHING)], Html(page()))),
        )
        .route(&format!("/python/{WHEEL}"), routing::get(async || ([(CONTENT_TYPE, "application/zip")], CONTENT)))
}

fn page() -> String {
    format!(
        r#"<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Python package · WSG Gateway</title>
<link rel="stylesheet" href="../docs/guide/style.css">
</head>
<body>
<header>
<nav aria-label="Pages"><a href="../docs/guide/">Guides</a> <a href="../docs">HTTP API</a> <a href="../">Dashboard</a></nav>
</header>
<main>
<h1>Python package</h1>
<p><a href="{WHEEL}">{WHEEL}</a></p>
<p>Install the package of this gateway's version, with the address that your browser shows in place of
<code>http://GATEWAY:8080</code>:</p>
<pre><code>pip install http://GATEWAY:8080/python/{WHEEL}</code></pre>
<p>The <a href="../docs/guide/python">guide</a> has a first program, and says how to install the package without internet
access.</p>
</main>
</body>
</html>
"#
    )
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::fs;
    use std::io::{Cursor, Read as _};
    use std::path::Path;

    use super::*;

    #[test]
    fn wheel_has_this_version_and_these_sources() {
        let mut wheel = zip::ZipArchive::new(Cursor::new(CONTENT)).unwrap();
        let mut packed = BTreeMap::new();
        for index in 0..wheel.len() {
            let mut file = wheel.by_index(index).unwrap();
            let name = file.name().unwrap().into_owned();
            let mut content = Vec::new();
            file.read_to_end(&mut content).unwrap();
            packed.insert(name, content);
        }
        let metadata = &packed[concat!("wsg_gateway-", env!("CARGO_PKG_VERSION"), ".dist-info/METADATA")];
        let version = concat!("\nVersion: ", env!("CARGO_PKG_VERSION"), "\n");
        assert!(String::from_utf8_lossy(metadata).contains(version));

        let package = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/python/wsg_gateway");
        for entry in fs::read_dir(package).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                continue; // Python's cache.
            }
            let name = format!("wsg_gateway/{}", path.file_name().unwrap().to_str().unwrap());
            assert!(
                packed.remove(&name).is_some_and(|content| content == fs::read(&path).unwrap()),
                "{name} in the wheel is out of date: run deploy/python/generate.py"
            );
        }
        let others: Vec<_> = packed.keys().filter(|name| name.starts_with("wsg_gateway/")).collect();
        assert_eq!(others, ["wsg_gateway/LICENSE"]);
    }
}
