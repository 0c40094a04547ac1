//! Names in the OpenAPI document become names in generated code, so no common language may reserve them.

use std::fs;
use std::path::Path;

use serde_json::Value;

/// Words of C, C++, C#, Go, Java, JavaScript, Kotlin, PHP, Python, Ruby, Rust, Swift and TypeScript that cannot be the
/// name of a function.
const RESERVED: &str = "
    abstract alignas alignof and array as asm assert associatedtype async auto await base become begin bool boolean box
    break byte callable case catch chan char checked class clone co_await co_return co_yield compl concept const
    constexpr continue crate debugger decimal declare decltype def default defer deferred defined deinit del delegate
    delete die do double dyn echo elif else elsif elseif empty end endfor endif endwhile ensure enum error eval event
    except exit explicit export extends extension extern fallthrough false fileprivate final finally fixed float fn for
    foreach friend from fun func function global go goto guard if impl implements implicit import in include indirect init
    inline inout insteadof instanceof int interface internal is isset lambda let list lock long loop macro map match
    module move mut mutable namespace native new next nil noexcept none nonlocal not null nullptr number object operator
    or override package params pass print priv private protected protocol public pub raise range readonly redo ref
    register reinterpret_cast repeat require requires rescue restrict rethrows retry return sbyte sealed select self short
    signed sizeof stackalloc static static_assert strictfp string struct subscript super switch synchronized template then
    this thread_local throw throws trait transient true try type typealias typedef typeid typename typeof uint ulong
    unchecked undef union unless unset unsafe unsigned unsized until use using val var virtual void volatile wchar_t when
    where while with xor yield";

#[test]
fn no_language_reserves_an_operation_or_a_type() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("openapi/openapi.json");
    let document: Value = serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
    let paths = document["paths"].as_object().unwrap().values();
    let operations: Vec<_> = paths
        .flat_map(|path| path.as_object().unwrap().values())
        .filter_map(|one| one["operationId"].as_str())
        .collect();
    assert!(operations.len() > 100, "{operations:?}");
    let is_reserved = |name: &&str| RESERVED.split_whitespace().any(|word| word == *name);
    let reserved: Vec<_> = operations.into_iter().filter(is_reserved).collect();
    assert_eq!(reserved, Vec::<&str>::new(), "give these operations another operation_id");
    // Go compiles a file whose name ends with _test for tests alone, and Maven runs a class whose name ends with Test.
    let schemas = document["components"]["schemas"].as_object().unwrap().keys();
    let tests: Vec<_> = schemas.filter(|name| name.ends_with("Test") || is_reserved(&name.as_str())).collect();
    assert_eq!(tests, Vec::<&String>::new(), "give these schemas other names");
}

/// A generator takes the type from the format, so a value beyond it would be an error of the client.
#[test]
fn values_fit_the_type_that_the_format_names() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("openapi/openapi.json");
    let document: Value = serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
    let mut open = vec![(String::new(), &document["components"]["schemas"])];
    let mut wrong = Vec::new();
    while let Some((place, value)) = open.pop() {
        let max = value["maximum"].as_i64();
        if value["format"] == "int32" && max.is_some_and(|max| max > i64::from(i32::MAX)) {
            wrong.push(place.clone());
        }
        let parts = value.as_object().into_iter().flatten();
        open.extend(parts.map(|(name, part)| (format!("{place}/{name}"), part)));
    }
    assert_eq!(wrong, Vec::<String>::new(), "these values need the format int64");
}
