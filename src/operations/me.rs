//! The client's own identity.

use std::sync::Arc;

use serde::Serialize;
use utoipa::ToSchema;

use super::calls::call::{Call, NoFields};
use super::calls::operation::operations;
use super::calls::reply::Json;
use super::problem::Problem;
use crate::access::{Identity, Proof, Right, Role};
use crate::model::Name;

operations! {
    // Every client with a credential may read its own identity, whatever its role.
    /// Get my identity
    ///
    /// Returns who the client is to the gateway, what it may do with each gripper, and until when.
    ME = GET "/me" as "me" {
        run: me, id: "me", tag: "gateway", problems: ANY,
        answer: "The client's identity",
    }.needs(Right::FastStop);
}

/// Identity and rights of a client.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "name": "plc7", "subject": "plc7", "role": "operator", "proof": "token",
    "grippers": [{"gripper": "left", "role": "operator"}, {"gripper": "right", "role": "observer"}],
    "expires_at": "2027-02-20T08:00:00.000Z"
}))]
pub struct Me {
    /// Name of the credential; null on a gateway that needs no credentials.
    name: Option<Name>,
    /// The client as events name it.
    subject: Arc<str>,
    role: Role,
    proof: Proof,
    /// The client's role for each gripper of this gateway.
    grippers: Vec<GripperRole>,
    /// Time at which the credential expires; null if it does not.
    #[schema(value_type = Option<String>, format = DateTime)]
    expires_at: Option<String>,
}

/// The role of a client for a gripper.
#[derive(Debug, Serialize, ToSchema)]
pub struct GripperRole {
    gripper: Name,
    /// The client's role for this gripper; null if it may only trigger FAST STOPs.
    #[schema(value_type = Option<Role>)]
    role: Option<Role>,
}

fn me(call: &Call<NoFields>) -> Result<Json<Me>, Problem> {
    let NoFields {} = call.fields()?;
    let Identity { name, role, expires_at, proof, scope, .. } = call.caller.identity.clone()?;
    // Reads are not limited to the credential's grippers.
    let elsewhere = role.has(Right::Read).then_some(Role::Observer);
    let mut grippers = Vec::new();
    for gripper in call.gateway.grippers.all() {
        let name = gripper.name();
        let role = if scope.contains(Some(name)) { Some(role) } else { elsewhere };
        grippers.push(GripperRole { gripper: name.clone(), role });
    }
    let subject = call.caller.client.subject.clone();
    let expires_at = expires_at.map(|at| format!("{at:.3}"));
    Ok(Json(Me { name, subject, role, proof, grippers, expires_at }))
}
