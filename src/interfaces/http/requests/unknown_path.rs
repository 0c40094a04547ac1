//! The answer to a request for a path that does not exist.

use crate::interfaces::http::context::API;
use crate::operations::parameters::nearest::similarity;
use crate::operations::{Problem, all};

/// Paths below the API's root that only HTTP has: documents, pages of the journal, files, sessions and streams.
pub const ONLY_HTTP: [&str; 18] = [
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
    "/tickets",
    "/ws",
];

/// Paths beside the API.
const BESIDE: [&str; 6] = ["/docs", "/docs/guide", "/healthz", "/metrics", "/python", "/readyz"];

/// Returns the problem for a path that does not exist, with the nearest path that does.
pub fn unknown_path(path: &str) -> Problem {
    let suggestion = nearest(path).map(|path| format!(" did you mean {path}?")).unwrap_or_default();
    Problem::not_found(format!("such path:{suggestion} /docs lists all paths"))
}

/// Returns the problem for a path whose parameters are not text, or lack one.
pub fn no_such_path() -> Problem {
    Problem::not_found("such path")
}

/// Returns the path that resembles the given one most, which may lack the API's root.
fn nearest(given: &str) -> Option<String> {
    let given = given.trim_end_matches('/');
    let below_root = format!("{API}{given}");
    let own = all().map(|operation| operation.path);
    let fleet =
        own.clone().filter(|path| path.starts_with("/grippers/")).map(|path| format!("/fleet/{{gateway}}{path}"));
    let below = own.chain(ONLY_HTTP).map(str::to_owned).chain(fleet).map(|path| format!("{API}{path}"));
    let known = below.chain(BESIDE.map(str::to_owned));
    let similar = known.flat_map(|known| [given, &*below_root].map(|given| filled(&known, given)));
    let nearest = similar.flatten().max_by(|one, other| one.0.total_cmp(&other.0));
    nearest.map(|(_, path)| path)
}

/// Fills the variables of a known path from a given one. Returns the path with its similarity to the given one, or `None`
/// if one of their parts differs too much.
fn filled(known: &str, given: &str) -> Option<(f64, String)> {
    if known.split('/').count() != given.split('/').count() {
        return None;
    }
    let mut total = 1.0;
    let mut path = Vec::new();
    for (known, given) in known.split('/').zip(given.split('/')) {
        if known.starts_with('{') && !given.is_empty() {
            path.push(given);
        } else {
            total *= similarity(given, known)?;
            path.push(known);
        }
    }
    Some((total, path.join("/")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_path_is_named() {
        for (given, expected) in [
            ("/api/v1/grippers/left/grasp", "/api/v1/grippers/left/grip"),
            ("/api/v1/gripper/left/move", "/api/v1/grippers/left/move"),
            ("/grippers/left/home", "/api/v1/grippers/left/home"),
            ("/api/v2/grippers", "/api/v1/grippers"),
            ("/api/v1/grippers/", "/api/v1/grippers"),
            ("/api/v1/grippers/left/settings/acceleration_mm_s2", "/api/v1/grippers/left/settings/acceleration"),
            ("/api/v1/fleet/cell-2/grippers/left/relase", "/api/v1/fleet/cell-2/grippers/left/release"),
            ("/api/v1/event", "/api/v1/events"),
            ("/health", "/healthz"),
        ] {
            assert_eq!(nearest(given).as_deref(), Some(expected), "{given}");
        }
        for given in ["/nowhere", "", "/wp-admin/setup.php", &"/x".repeat(1000), &format!("/{}", "x".repeat(10_000))] {
            assert_eq!(nearest(given), None, "{given}");
        }
    }
}
