//! Consistency of the paths with the table of operations.

use crate::interfaces::http::{API, openapi};
use crate::operations::OPERATIONS;

#[test]
fn paths_and_operations_match() {
    let document = openapi();
    let paths = document["paths"].as_object().unwrap();
    for operation in OPERATIONS {
        let path = paths.get(&format!("{API}{}", operation.path));
        let documented = path.and_then(|path| path.get(operation.verb.as_str().to_lowercase()));
        assert!(documented.is_some(), "{} has no path", operation.name);
    }
    for (path, item) in paths.iter().filter(|(path, _)| path.starts_with("/api/v1/grippers/")) {
        for verb in item.as_object().unwrap().keys() {
            let is_it =
                |path_of: &str, verb_of: &str| format!("{API}{path_of}") == *path && verb_of.eq_ignore_ascii_case(verb);
            assert!(
                OPERATIONS.iter().any(|operation| is_it(operation.path, operation.verb.as_str())),
                "{verb} {path} is not an operation"
            );
        }
    }
}
