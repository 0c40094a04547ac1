//! Releasing a gripper to another program, such as the vendor's tool, and connecting to it again.

use std::sync::Arc;

use http::Method as Verb;

use super::call::Call;
use super::operation::{Operation, reply};
use super::problem::Problem;
use super::reply::Json;
use crate::gripper::model::State;

pub const DISCONNECT: Operation =
    Operation::change("disconnect", &Verb::POST, "/grippers/{gripper}/disconnect", |call| reply(disconnect(call)));
pub const CONNECT: Operation =
    Operation::change("connect", &Verb::POST, "/grippers/{gripper}/connect", |call| reply(connect(call)));

async fn disconnect(call: Call) -> Result<Json<Arc<State>>, Problem> {
    let gripper = call.leased()?;
    gripper.handle.disconnect(gripper.client.clone(), gripper.token()).await?;
    Ok(Json(gripper.handle.state()))
}

async fn connect(call: Call) -> Result<Json<Arc<State>>, Problem> {
    let gripper = call.leased()?;
    gripper.handle.connect(gripper.client.clone(), gripper.token()).await?;
    Ok(Json(gripper.handle.state()))
}
