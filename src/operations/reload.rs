//! Reading the configuration again, without a restart.

use serde::Serialize;
use tokio::sync::oneshot;
use utoipa::ToSchema;

use super::calls::call::{Call, NoFields};
use super::calls::operation::operations;
use super::calls::reply::Json;
use super::problem::Problem;
use super::reload_requests::ReloadRequest;
use crate::access::Right;
use crate::model::Code;

operations! {
    /// Reload the configuration
    ///
    /// Reads the configuration file again and applies what has changed: grippers, WSG ports, the address, credentials,
    /// certificates and limits. Grippers with the same configuration are not touched. If anything cannot be used,
    /// nothing changes.
    RELOAD = POST "/reload" as "reload" {
        run: reload, id: "reload", tag: "gateway", problems: RELOAD,
        answer: "The new configuration is in use",
    }.needs(Right::Supervise);
}

/// Result of a reload.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"changes": ["gripper left: added", "gripper right: changed", "hosts: changed"]}))]
pub struct Reloaded {
    /// The changes, in words; empty without any.
    changes: Vec<String>,
}

async fn reload(call: Call<NoFields>) -> Result<Json<Reloaded>, Problem> {
    let NoFields {} = call.fields()?;
    let (answer, answered) = oneshot::channel();
    let request = ReloadRequest { client: call.caller.client.clone(), answer };
    if call.gateway.reloads.request(request).is_err() {
        return Err(Problem::new(Code::Overloaded, "too many reloads are waiting: try again later"));
    }
    let changes = answered
        .await
        .map_err(|_| Problem::new(Code::Overloaded, "the gateway is shutting down, so it does not reload"))?;
    let changes = changes.map_err(|cause| Problem::new(Code::InvalidConfiguration, cause))?;
    Ok(Json(Reloaded { changes }))
}
