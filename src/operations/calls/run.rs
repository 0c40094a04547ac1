//! Running an operation for a caller.

use std::collections::BTreeMap;
use std::future::ready;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use futures_util::FutureExt as _;
use serde::Deserialize as _;
use serde_json::{Map, Value};

use super::audit::RefusedRequest;
use super::call::{Call, Fields, PART_ID, Params};
use super::caller::Caller;
use super::operation::Operation;
use super::reply::OperationReply;
use super::rights::check;
use crate::access::{Access, Identity, Unauthorized};
use crate::model::{Code, Urgency};
use crate::operations::gateway::Gateway;
use crate::operations::gripper::fast_stop;
use crate::operations::parameters::values::TextOrNumber;
use crate::operations::problem::Problem;
use crate::operations::table::Method;

/// Notes that a browser's session is used, which keeps it and its PIN from expiring.
pub fn note_use(access: &Access, operation: &Operation, identity: &Result<Identity, Unauthorized>) {
    if let Some(session) = identity.as_ref().ok().and_then(|identity| identity.session.as_ref()) {
        // A web page renews its lease by itself, so a renewal does not show that its user is active.
        let is_change = operation.changes_something() && operation.urgency != Urgency::Lease;
        access.note_use(session, is_change);
    }
}

/// Runs an operation for a caller, and records a refusal.
///
/// The answer to a client that is refused continually is delayed, unless the operation is urgent. An operation ends with
/// its caller: an interface that can lose its client spawns what stops fingers.
///
/// # Errors
/// The problem for the caller.
pub async fn run(
    gateway: &Arc<Gateway>,
    operation: &'static Operation,
    caller: Caller,
    params: Params,
) -> Result<OperationReply, Problem> {
    let client = caller.client.clone();
    let gripper = params.gripper();
    let allowed = check(&gateway.access, operation.right, &caller.identity, gripper.as_ref());
    let running = match allowed.map_err(|problem| missing_gripper(gateway, &params, &problem).unwrap_or(problem)) {
        Ok(()) => {
            note_use(&gateway.access, operation, &caller.identity);
            (operation.start)(Call::new(gateway.clone(), caller, params))
        }
        Err(problem) => ready(Err(problem)).boxed(),
    };
    let mut result = AssertUnwindSafe(running).catch_unwind().await.unwrap_or_else(|_| {
        tracing::error!(operation = operation.name, "operation panicked");
        Err(Problem::internal())
    });
    if let Err(problem) = &mut result
        && (operation.changes_something() || problem.code() == Code::Unauthorized)
        && !problem.is_recorded()
    {
        let request = RefusedRequest {
            gripper,
            client,
            command: operation.journal_command().to_owned(),
            code: problem.code_word(),
        };
        problem.mark_recorded();
        gateway.audit.record(request, problem.detail(), operation.urgency).await;
    }
    result
}

/// Returns `not_found` in place of `forbidden` if the gripper does not exist, since that is the better reason.
fn missing_gripper(gateway: &Gateway, params: &Params, problem: &Problem) -> Option<Problem> {
    let name = params.path.get("gripper").filter(|_| problem.code() == Code::Forbidden)?;
    let exists = params.gripper().is_some_and(|gripper| gateway.grippers.get(&gripper).is_some());
    // The caller is known: an unknown one gets `unauthorized`.
    (!exists).then(|| gateway.no_gripper(name, true))
}

/// Runs the operation of a method whose path parameters are given. A FAST STOP with wrong parameters stops all grippers, since the intended one is
/// among them.
///
/// # Errors
/// The problem for the caller.
pub async fn call(
    gateway: &Arc<Gateway>,
    caller: Caller,
    method: Method,
    params: Value,
) -> Result<OperationReply, Problem> {
    if !method.is_fast_stop() {
        let (operation, params) = resolve(method, params)?;
        return run(gateway, operation, caller, params).await;
    }
    let reason = params.get("reason").cloned().unwrap_or_default();
    let result = match resolve(method, params) {
        Ok((operation, params)) => run(gateway, operation, caller.clone(), params).await,
        Err(problem) => Err(problem),
    };
    let Err(_) = result else { return result };
    let operation = method.operations().find(|operation| operation.path_parameters().next().is_none());
    let fields = Fields::Object(Map::from_iter([("reason".to_owned(), reason)]));
    run(gateway, operation.unwrap_or(&fast_stop::ALL), caller, Params { fields, ..Params::default() }).await
}

/// Finds the operation of a method, and splits the parameters into path and fields. The first operation whose path
/// parameters are all given is chosen.
fn resolve(method: Method, params: Value) -> Result<(&'static Operation, Params), Problem> {
    let mut object = match params {
        Value::Object(object) => object,
        Value::Null => Map::new(),
        _ if method.is_fast_stop() => Map::new(),
        _ => return Err(Problem::malformed("params", "params must be an object, not an array or a single value")),
    };
    let operation = method.operations().find(|operation| is_addressed(operation, &object)).unwrap_or(method.shared());
    let mut path = BTreeMap::new();
    for key in operation.path_parameters() {
        path.insert(key, path_part(key, object.remove(key))?);
    }
    Ok((operation, Params { path, fields: Fields::Object(object), ..Params::default() }))
}

/// Whether the parameters have all parts of an operation's path.
fn is_addressed(operation: &Operation, object: &Map<String, Value>) -> bool {
    operation.path_parameters().all(|key| object.get(key).is_some_and(|value| !value.is_null()))
}

/// Returns a path parameter. A value that cannot be a name is reported as not found; parts can have any name.
fn path_part(key: &str, value: Option<Value>) -> Result<String, Problem> {
    let part = match value {
        Some(value) if !value.is_null() => TextOrNumber::deserialize(value)
            .map_err(|_| Problem::malformed(key, format!("{key} must be a string or a whole number")))?
            .to_string(),
        _ => return Err(Problem::malformed(key, format!("{key} is missing"))),
    };
    if key != PART_ID && (part.is_empty() || !part.bytes().all(is_name_byte)) {
        return Err(Problem::not_found(format!("such {key}")).field(key));
    }
    Ok(part)
}

fn is_name_byte(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_')
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::access::{Role, Scope};
    use crate::gripper::fake::{self, FakeScript};
    use crate::model::{Client, Door};
    use crate::operations::gripper::{grippers, motion};

    fn resolved(name: &str, params: Value) -> (&'static str, Params) {
        let (operation, params) = resolve(Method::named(name).unwrap(), params).unwrap();
        (operation.path, params)
    }

    fn refused(name: &str, params: Value) -> Value {
        let resolved = Method::named(name).and_then(|method| resolve(method, params));
        serde_json::to_value(resolved.unwrap_err().members()).unwrap()
    }

    #[test]
    fn parameters_are_split_into_path_and_fields() {
        let (path, params) = resolved("fingers.data", json!({"gripper": "left", "finger": 2, "lease": "t"}));
        assert_eq!(path, "/grippers/{gripper}/fingers/{finger}/data");
        assert_eq!(params.path["gripper"], "left");
        assert_eq!(params.path["finger"], "2");
        assert!(matches!(params.fields, Fields::Object(fields) if fields.len() == 1));
    }

    #[test]
    fn fast_stop_without_gripper_stops_all() {
        assert_eq!(resolved("fast-stop", json!({"gripper": "left"})).0, "/grippers/{gripper}/fast-stop");
        for params in
            [json!({}), Value::Null, json!([1, 2]), json!("now"), json!({"reason": 7}), json!({"gripper": null})]
        {
            assert_eq!(resolved("fast-stop", params).0, "/fast-stop");
        }
    }

    #[test]
    fn missing_or_invalid_path_parameter_is_named() {
        assert_eq!(refused("grip", json!({"width_mm": 20}))["field"], "gripper");
        assert_eq!(refused("grip", json!({"gripper": null}))["detail"], "gripper is missing");
        assert_eq!(refused("grip", json!(["left", 20]))["field"], "params");
        for name in ["", "../left", "left/grip", "left?x=1", "l\u{f6}ft"] {
            assert_eq!(refused("state", json!({"gripper": name}))["code"], "not_found", "{name}");
        }
        assert_eq!(refused("xyz", json!({}))["detail"], "no method \"xyz\"");
        assert_eq!(refused("grasp", json!({}))["detail"], "no method \"grasp\": did you mean grip?");
    }

    #[tokio::test]
    async fn missing_gripper_is_reported_to_known_callers_only() {
        let gateway = Gateway::of([fake::gripper("left", FakeScript::default()).0]);
        let scope = Scope::Only(["left".parse().unwrap()].into());
        let [robot, panel] = [Role::Operator, Role::Observer]
            .map(|role| Ok(Identity { role, scope: scope.clone(), ..Identity::anyone() }));
        let refused = async |identity: &Result<Identity, Unauthorized>, name: &str, gripper: &str| {
            let caller = Caller::new(Client::new("test", Door::Http), identity.clone());
            let problem =
                call(&gateway, caller, Method::named(name).unwrap(), json!({"gripper": gripper})).await.unwrap_err();
            (problem.code(), problem.detail().to_owned())
        };
        let missing = (Code::NotFound, "no gripper is named lefft: this gateway has left".to_owned());
        for (identity, name) in [(&robot, "home"), (&robot, "state"), (&panel, "home"), (&panel, "state")] {
            assert_eq!(refused(identity, name, "lefft").await, missing, "{name}");
        }
        assert_eq!(refused(&panel, "home", "left").await.0, Code::Forbidden);
        let (code, detail) = refused(&Err(Unauthorized::Missing), "home", "lefft").await;
        assert!(code == Code::Unauthorized && !detail.contains("left"), "{detail}");
    }

    #[tokio::test]
    async fn unknown_field_is_named() {
        let gateway = Gateway::of([fake::gripper("left", FakeScript::default()).0]);
        let caller = Caller::new(Client::new("test", Door::Ws), Ok(Identity::anyone()));
        let params = json!({"gripper": "left", "width_mm": 20});
        let problem = call(&gateway, caller, Method::from(&grippers::STATE), params).await.unwrap_err();
        assert_eq!(serde_json::to_value(problem.members()).unwrap()["field"], "width_mm");
    }

    #[tokio::test]
    async fn null_field_counts_as_absent() {
        let gateway = Gateway::of([fake::gripper("left", FakeScript::default()).0]);
        let caller = Caller::new(Client::new("test", Door::Ws), Ok(Identity::anyone()));
        let params = json!({"gripper": "left", "direction": null, "request_id": null, "lease": null});
        let home = Method::from(&motion::HOME);
        assert!(call(&gateway, caller.clone(), home, params).await.is_ok());
        let problem = call(&gateway, caller, home, json!({"gripper": "left", "way": null})).await.unwrap_err();
        assert_eq!(problem.detail(), "unknown field way; known: direction, request_id, lease");
    }
}
