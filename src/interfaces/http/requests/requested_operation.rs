//! The operation that a request asks for, found once, before anything else happens to the request.

use std::collections::BTreeMap;

use axum::http::{Method as Verb, Request};

use crate::interfaces::http::context::API;
use crate::model::Urgency;
use crate::operations::{Operation, all};

/// Path before that of a gripper of any gateway.
const FLEET: &str = "/fleet/{gateway}";

/// The operation that a request asks for, on any gateway; `None` if its path has none, or not with its method.
#[derive(Debug, Clone, Copy, Default)]
pub struct Asked(Option<&'static Operation>);

impl Asked {
    /// Returns how urgent the request is. An urgent one only stops a gripper, or keeps or ends a lease. It is never
    /// refused in favour of others.
    pub fn urgency(self) -> Urgency {
        self.0.map_or(Urgency::None, |operation| operation.urgency)
    }

    /// Whether the request asks for an operation, which checks its caller's rights.
    pub fn is_operation(self) -> bool {
        self.0.is_some()
    }

    /// Whether the request asks for this operation.
    pub fn is(self, operation: &Operation) -> bool {
        self.0.is_some_and(|asked| asked.id == operation.id)
    }

    /// Whether the request only stops fingers: a FAST STOP, a Stop or a cancel.
    pub fn stops(self) -> bool {
        matches!(self.urgency(), Urgency::FastStop | Urgency::Stop)
    }

    /// Whether the request is executed whatever its body says, and so does not wait for its body.
    pub fn ignores_mistakes(self) -> bool {
        self.0.is_some_and(|operation| operation.ignores_mistakes)
    }
}

/// The paths of all operations, below the API's root and below the fleet's grippers.
#[derive(Debug, Clone)]
pub struct OperationPaths(matchit::Router<Vec<&'static Operation>>);

impl OperationPaths {
    /// Finds the operation that a request asks for, and notes it for all that follows.
    pub fn mark<B>(&self, request: &mut Request<B>) -> Asked {
        let verb = if request.method() == Verb::HEAD { &Verb::GET } else { request.method() };
        let of_path = self.0.at(request.uri().path()).map(|found| found.value.iter().copied());
        let asked = Asked(of_path.ok().and_then(|mut of_path| of_path.find(|operation| operation.verb == verb)));
        request.extensions_mut().insert(asked);
        asked
    }
}

impl Default for OperationPaths {
    fn default() -> Self {
        let mut by_path: BTreeMap<String, Vec<&'static Operation>> = BTreeMap::new();
        for operation in all() {
            let own = format!("{API}{}", operation.path);
            let fleet = operation.is_of_gripper().then(|| format!("{API}{}{}", FLEET, operation.path));
            for path in [Some(own), fleet].into_iter().flatten() {
                if operation.urgency == Urgency::FastStop {
                    // A FAST STOP with a trailing slash is accepted.
                    by_path.entry(format!("{path}/")).or_default().push(operation);
                }
                by_path.entry(path).or_default().push(operation);
            }
        }
        let mut paths = matchit::Router::new();
        for (path, operations) in by_path {
            // Fails only if two paths differ in nothing but the names of their variables.
            let inserted = paths.insert(path, operations);
            debug_assert!(inserted.is_ok(), "{inserted:?}");
        }
        Self(paths)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(verb: &Verb, path: &str) -> Asked {
        let mut request = Request::builder().method(verb).uri(format!("{API}{path}")).body(()).unwrap();
        OperationPaths::default().mark(&mut request)
    }

    #[test]
    fn every_operation_is_found_here_and_in_the_fleet() {
        for operation in all() {
            let path = operation.path.replace(['{', '}'], "");
            let fleet = format!("/fleet/cell-2{path}");
            for path in [Some(path), operation.is_of_gripper().then_some(fleet)].into_iter().flatten() {
                assert_eq!(asked(operation.verb, &path).0.map(|found| found.id), Some(operation.id), "{path}");
            }
        }
    }

    #[test]
    fn urgency_is_that_of_the_operation() {
        for gateway in ["", "/fleet/cell-2"] {
            for (verb, path, urgency, stops, ignores_mistakes) in [
                (Verb::POST, "grippers/left/fast-stop", Urgency::FastStop, true, true),
                (Verb::POST, "grippers/left/fast-stop/", Urgency::FastStop, true, true),
                (Verb::POST, "grippers/left/stop", Urgency::Stop, true, true),
                (Verb::POST, "grippers/left/commands/7/cancel", Urgency::Stop, true, false),
                (Verb::PUT, "grippers/left/lease", Urgency::Lease, false, false),
                (Verb::DELETE, "grippers/left/lease", Urgency::Lease, false, false),
                (Verb::POST, "grippers/left/lease", Urgency::None, false, false),
                (Verb::GET, "grippers/left/stop", Urgency::None, false, false),
                (Verb::POST, "grippers/left/unknown/fast-stop", Urgency::None, false, false),
            ] {
                let asked = asked(&verb, &format!("{gateway}/{path}"));
                assert_eq!(asked.urgency(), urgency, "{verb} {path}");
                assert_eq!((asked.stops(), asked.ignores_mistakes()), (stops, ignores_mistakes), "{verb} {path}");
            }
        }
        assert!(asked(&Verb::HEAD, "/grippers").is_operation());
        for path in ["/fast-stop", "/fast-stop/", "/fleet/fast-stop"] {
            assert_eq!(asked(&Verb::POST, path).urgency(), Urgency::FastStop, "{path}");
        }
    }
}
