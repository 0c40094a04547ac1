//! Releasing a gripper to another program, such as the vendor's tool, and connecting to it again.

use crate::model::State;
use crate::operations::calls::call::{Call, Leased};
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::SharedJson;
use crate::operations::problem::Problem;

operations! {
    /// Release a gripper to another program
    ///
    /// Announces the disconnect to the device and closes the link, so that another program, such as the vendor's tool,
    /// can connect. The state `link` is `released` until a `connect` request or a restart of the gateway. Refused while
    /// the fingers move.
    DISCONNECT = POST "/grippers/{gripper}/disconnect" as "disconnect" {
        run: disconnect, id: "disconnect", tag: "device", problems: DEVICE,
        answer: "The state after the link was closed",
    };

    /// Connect to a released gripper
    ///
    /// Lets the gateway connect to the device again. Returns at once; `link` shows when the link is connected. A FAST
    /// STOP that was latched while the gripper was released is sent first.
    CONNECT = POST "/grippers/{gripper}/connect" as "connect" {
        run: connect, id: "connect", tag: "device", problems: DEVICE,
        answer: "The state; the link is not connected yet",
    };
}

async fn disconnect(call: Call<Leased>) -> Result<SharedJson<State>, Problem> {
    let gripper = call.leased()?;
    gripper.handle.disconnect(gripper.client.clone(), gripper.token()).await?;
    Ok(SharedJson(gripper.handle.state()))
}

async fn connect(call: Call<Leased>) -> Result<SharedJson<State>, Problem> {
    let gripper = call.leased()?;
    gripper.handle.connect(gripper.client.clone(), gripper.token()).await?;
    Ok(SharedJson(gripper.handle.state()))
}
