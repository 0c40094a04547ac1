//! Consistency of the paths with the table of operations.

use crate::interfaces::http::{API, openapi};
use crate::operations::OPERATIONS;

/// Paths that only HTTP has: documents, pages of the journal, files, sessions and streams.
const ONLY_HTTP: [&str; 17] = [
    "/asyncapi.yaml",
    "/events",
    "/events.csv",
    "/fleet/events",
    "/fleet/grips",
    "/fleet/readiness",
    "/grips",
    "/grips.csv",
    "/grips/{command}",
    "/grips/{command}/curve",
    "/grips/{command}/curve.csv",
    "/openapi.json",
    "/recipes.csv",
    "/session",
    "/session/pin",
    "/stream",
    "/ws",
];

/// Requests for another gateway, which performs the operation.
const FORWARDED: &str = "/fleet/{gateway}/";

#[test]
fn paths_and_operations_match() {
    let document = openapi();
    let paths = document["paths"].as_object().unwrap();
    for operation in OPERATIONS {
        let path = paths.get(&format!("{API}{}", operation.path));
        let documented = path.and_then(|path| path.get(operation.verb.as_str().to_lowercase()));
        assert!(documented.is_some(), "{} has no path", operation.name);
    }
    let api = paths.iter().filter_map(|(path, item)| Some((path.strip_prefix(API)?, item)));
    for (path, item) in api.filter(|(path, _)| !ONLY_HTTP.contains(path) && !path.starts_with(FORWARDED)) {
        for verb in item.as_object().unwrap().keys() {
            let is_it = |path_of: &str, verb_of: &str| path_of == path && verb_of.eq_ignore_ascii_case(verb);
            assert!(
                OPERATIONS.iter().any(|operation| is_it(operation.path, operation.verb.as_str())),
                "{verb} {path} is not an operation"
            );
        }
    }
}
