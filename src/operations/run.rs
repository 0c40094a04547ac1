//! Running an operation for a caller.

use std::future::ready;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use futures_util::FutureExt as _;
use serde::Deserialize as _;
use serde_json::{Map, Value};
use tracing::Instrument as _;

use super::audit::RefusedRequest;
use super::call::{Call, Fields, PART_ID, Params};
use super::caller::Caller;
use super::fast_stop;
use super::gateway::Gateway;
use super::operation::Operation;
use super::problem::Problem;
use super::reply::OperationReply;
use super::rights::check;
use super::table::{is_fast_stop, named};
use super::values::{TextOrNumber, shortened};
use crate::access::{Access, Identity, Unauthorized};
use crate::gripper::model::{Code, Urgency};

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
/// A FAST STOP runs to its end even if its caller is gone. The answer to a client that is refused continually is
/// delayed, unless the operation is urgent.
///
/// # Errors
/// The problem for the caller.
pub async fn run(
    gateway: &Arc<Gateway>,
    operation: &'static Operation,
    caller: Caller,
    params: Params,
) -> Result<OperationReply, Problem> {
    let (client, gripper) = (caller.client.clone(), params.gripper());
    let allowed = check(&gateway.access, operation.right, &caller.identity, gripper.as_ref());
    let running = match allowed.map_err(|problem| missing_gripper(gateway, &params, &problem).unwrap_or(problem)) {
        Ok(()) => {
            note_use(&gateway.access, operation, &caller.identity);
            operation.start(Call { gateway: gateway.clone(), caller, params })
        }
        Err(problem) => ready(Err(problem)).boxed(),
    };
    let running = AssertUnwindSafe(running).catch_unwind();
    let ended = if operation.urgency == Urgency::FastStop {
        tokio::spawn(running.in_current_span()).await.unwrap_or_else(|error| Err(Box::new(error)))
    } else {
        running.await
    };
    let mut result = ended.unwrap_or_else(|_| {
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

/// Runs the operation with this name. A FAST STOP with wrong parameters stops all grippers, since the intended one is
/// among them.
///
/// # Errors
/// The problem for the caller.
pub async fn call(
    gateway: &Arc<Gateway>,
    caller: Caller,
    name: &str,
    params: Value,
) -> Result<OperationReply, Problem> {
    if !is_fast_stop(name) {
        let (operation, params) = resolve(name, params)?;
        return run(gateway, operation, caller, params).await;
    }
    let reason = params.get("reason").cloned().unwrap_or_default();
    let result = match resolve(name, params) {
        Ok((operation, params)) => run(gateway, operation, caller.clone(), params).await,
        Err(problem) => Err(problem),
    };
    let Err(_) = result else { return result };
    let operation = named(name).find(|operation| operation.path_parameters().next().is_none());
    let fields = Fields::Object(Map::from_iter([("reason".to_owned(), reason)]));
    run(gateway, operation.unwrap_or(&fast_stop::ALL), caller, Params { fields, ..Params::default() }).await
}

/// Finds the operation with this name, and splits the parameters into path and fields. The first operation whose
/// path parameters are all given is chosen.
fn resolve(name: &str, params: Value) -> Result<(&'static Operation, Params), Problem> {
    let first = named(name).next().ok_or_else(|| Problem::not_found(format!("method {:?}", shortened(name))))?;
    let mut object = match params {
        Value::Object(object) => object,
        Value::Null => Map::new(),
        _ if is_fast_stop(name) => Map::new(),
        _ => return Err(Problem::malformed("params", "params must be an object, not an array or a single value")),
    };
    let has_all = |operation: &&Operation| operation.path_parameters().all(|key| object.contains_key(key));
    let operation = named(name).find(has_all).unwrap_or(first);
    let part = |key| Ok((key, path_part(key, object.remove(key))?));
    let path = operation.path_parameters().map(part).collect::<Result<_, Problem>>()?;
    Ok((operation, Params { path, fields: Fields::Object(object), ..Params::default() }))
}

/// Returns a path parameter. A value that cannot be a name is reported as not found; parts can have any name.
fn path_part(key: &str, value: Option<Value>) -> Result<String, Problem> {
    let part = match value {
        Some(value) => TextOrNumber::deserialize(value)
            .map_err(|_| Problem::malformed(key, format!("{key} must be a string or a whole number")))?
            .to_string(),
        None => return Err(Problem::malformed(key, format!("{key} is missing"))),
    };
    let is_name = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_');
    if key != PART_ID && (part.is_empty() || !part.bytes().all(is_name)) {
        return Err(Problem::not_found(format!("such {key}")).field(key));
    }
    Ok(part)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::access::{Role, Scope};
    use crate::gripper::fake::{self, FakeScript};
    use crate::gripper::model::{Client, Door};

    fn resolved(name: &str, params: Value) -> (&'static str, Params) {
        let (operation, params) = resolve(name, params).unwrap();
        (operation.path, params)
    }

    fn refused(name: &str, params: Value) -> Value {
        serde_json::to_value(resolve(name, params).unwrap_err().members()).unwrap()
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
        for params in [json!({}), Value::Null, json!([1, 2]), json!("now"), json!({"reason": 7})] {
            assert_eq!(resolved("fast-stop", params).0, "/fast-stop");
        }
    }

    #[test]
    fn missing_or_invalid_path_parameter_is_named() {
        assert_eq!(refused("grip", json!({"width_mm": 20}))["field"], "gripper");
        assert_eq!(refused("grip", json!(["left", 20]))["field"], "params");
        for name in ["", "../left", "left/grip", "left?x=1", "l\u{f6}ft"] {
            assert_eq!(refused("state", json!({"gripper": name}))["code"], "not_found", "{name}");
        }
        assert_eq!(refused("leap", json!({}))["code"], "not_found");
    }

    #[tokio::test]
    async fn missing_gripper_is_reported_to_known_callers_only() {
        let gateway = Gateway::of([fake::gripper("left", FakeScript::default()).0]);
        let scope = Scope::Only(["left".parse().unwrap()].into());
        let [robot, panel] = [Role::Operator, Role::Observer]
            .map(|role| Ok(Identity { role, scope: scope.clone(), ..Identity::anyone() }));
        let refused = async |identity: &Result<Identity, Unauthorized>, name: &str, gripper: &str| {
            let caller = Caller::new(Client::new("test", Door::Http), identity.clone());
            let problem = call(&gateway, caller, name, json!({"gripper": gripper})).await.unwrap_err();
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
        let problem = call(&gateway, caller, "state", params).await.unwrap_err();
        assert_eq!(serde_json::to_value(problem.members()).unwrap()["field"], "width_mm");
    }
}
