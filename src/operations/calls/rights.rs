//! The check of a caller's rights. No other place decides them.

use crate::access::{Access, Identity, Right, Unauthorized};
use crate::model::{Code, Name};
use crate::operations::problem::Problem;

/// Checks that a caller has the right to an operation of a gripper, or of all grippers.
///
/// # Errors
/// The problem for the caller.
pub fn check(
    access: &Access,
    right: Right,
    identity: &Result<Identity, Unauthorized>,
    gripper: Option<&Name>,
) -> Result<(), Problem> {
    match identity {
        Err(_) if right == Right::FastStop && access.lets_anyone_stop() => Ok(()),
        Err(unknown) => Err((*unknown).into()),
        Ok(identity) => require(identity, right, gripper),
    }
}

/// Checks that a client has a right to a gripper, or to all grippers.
///
/// # Errors
/// The problem for the client.
pub fn require(identity: &Identity, right: Right, gripper: Option<&Name>) -> Result<(), Problem> {
    if identity.may(right, gripper) {
        return Ok(());
    }
    let who = identity.name.as_ref().map_or("this client", Name::as_str);
    let detail = if identity.role.has(right) {
        let what = gripper.map_or_else(|| "all grippers".to_owned(), |gripper| format!("gripper {gripper}"));
        format!("{who} has no rights to {what}: use a credential whose grippers include it")
    } else {
        format!("{who} has the role {}; this request needs the role {}", identity.role, right.role())
    };
    Err(Problem::new(Code::Forbidden, detail))
}
