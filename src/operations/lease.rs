//! The lease, which entitles one client to move the gripper.

use std::sync::Arc;
use std::time::Duration;

use http::Method as Verb;
use serde::Deserialize;
use utoipa::ToSchema;

use super::call::{Call, NoFields};
use super::connection_lease::ConnectionLease;
use super::operation::{Operation, reply};
use super::problem::Problem;
use super::reply::{Effect, Json, OperationReply};
use super::values::{integer, name, text};
use crate::access::Right;
use crate::fleet::keys::MAX_SUBJECT_BYTES;
use crate::gripper::model::lease::{MAX_TTL, MIN_TTL};
use crate::gripper::model::{Lease, OnLossHolding, OnLossMoving, TakeLease, Urgency};
use crate::gripper::{AcquiredLease, Conflict, Rejection};

const PATH: &str = "/grippers/{gripper}/lease";

pub const GET: Operation = Operation::read("lease", PATH, |call| reply(get(call)));
pub const TAKE: Operation = Operation::change("lease.take", &Verb::POST, PATH, |call| reply(take(call)));
pub const RENEW: Operation =
    Operation::change("lease.renew", &Verb::PUT, PATH, |call| reply(renew(call))).urgent(Urgency::Lease);
pub const RELEASE: Operation =
    Operation::change("lease.release", &Verb::DELETE, PATH, |call| reply(release(call))).urgent(Urgency::Lease);
pub const HAND_OVER: Operation =
    Operation::change("lease.hand-over", &Verb::POST, "/grippers/{gripper}/lease/hand-over", |call| {
        reply(hand_over(call))
    });

type LeaseResult = Result<Json<Lease>, Problem>;

async fn get(call: Call) -> LeaseResult {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    Ok(Json(gripper.with_lease(None)?.handle.lease().await?))
}

/// A request for the lease.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"holder": "robot-1", "ttl_ms": 3000}))]
pub struct Take {
    /// Name of the holder; by default the name of the client's credential, or else the client's address. At most 32
    /// bytes in UTF-8: printable ASCII, or letters, marks and digits of one script, composed (NFC). Invisible and
    /// look-alike characters are refused.
    #[schema(max_length = 32, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    holder: Option<String>,
    /// Time until the lease expires without use, in ms; 3000 by default.
    #[schema(value_type = Option<u64>, minimum = 100, maximum = 60000)]
    ttl_ms: Option<f64>,
    /// Reaction if the holder is lost while the fingers move. The default is `fast_stop`, unless the configuration has
    /// another.
    on_loss_moving: Option<OnLossMoving>,
    /// Reaction if the holder is lost while a part is held. The default is `keep`, unless the configuration has
    /// another.
    on_loss_holding: Option<OnLossHolding>,
    /// Takes the lease away from its current holder, as a supervisor does. A running motion is stopped.
    #[serde(default)]
    #[schema(default = false)]
    force: bool,
    /// Asks the current holder to hand the lease over. The response is 202 with the client's `place` among all that
    /// ask. After the hand-over, request the lease again to get its token.
    #[serde(default)]
    #[schema(default = false)]
    request: bool,
    /// Token of the lease, if the client already holds the lease and changes its terms. At most 64 bytes; empty means
    /// none.
    #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    lease: Option<String>,
}

async fn take(call: Call) -> Result<OperationReply, Problem> {
    let (gripper, body): (_, Take) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    if body.force {
        call.require(Right::Supervise)?;
    }
    let ttl = |ttl_ms| integer("ttl_ms", ttl_ms, MIN_TTL.as_millis() as u64..=MAX_TTL.as_millis() as u64);
    let holder = body.holder.as_deref().filter(|holder| !holder.is_empty());
    let take = TakeLease {
        holder: holder.map(|given| name("holder", given)).transpose()?,
        ttl: body.ttl_ms.map(ttl).transpose()?.map(Duration::from_millis),
        on_loss_moving: body.on_loss_moving,
        on_loss_holding: body.on_loss_holding,
        force: body.force,
        request: body.request,
        token: gripper.token(),
        client: gripper.client,
    };
    let (handle, has_ttl) = (gripper.handle, take.ttl.is_some());
    let taken = match handle.take_lease(take).await {
        Err(Rejection::Conflict(Conflict::LeaseRequested { place, .. })) => {
            let lease = Lease { place: Some(place), ..handle.lease().await? };
            return OperationReply::new(&lease, Effect::Waiting);
        }
        taken => taken?,
    };
    let AcquiredLease { lease, times_taken, keep } = taken;
    let keep = keep.filter(|_| !has_ttl);
    let leased = ConnectionLease::new(handle, &lease, times_taken, keep);
    OperationReply::new(&lease, leased.map_or(Effect::None, |lease| Effect::Leased(Arc::new(lease))))
}

async fn renew(call: Call) -> LeaseResult {
    let gripper = call.leased()?;
    Ok(Json(gripper.handle.renew_lease(gripper.token()).await?))
}

async fn release(call: Call) -> LeaseResult {
    let gripper = call.leased()?;
    Ok(Json(gripper.handle.release_lease(gripper.token()).await?))
}

/// The client that is to receive the lease.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"to": "robot-2"}))]
pub struct HandOver {
    /// Client in the lease's `requested_by`: a name or an address of at most 86 bytes in UTF-8.
    #[schema(max_length = 86, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    to: String,
    /// Token of the lease. At most 64 bytes; empty means none.
    #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    lease: Option<String>,
}

async fn hand_over(call: Call) -> LeaseResult {
    let (gripper, body): (_, HandOver) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    let to = text::<MAX_SUBJECT_BYTES>("to", &body.to)?;
    Ok(Json(gripper.handle.hand_over(gripper.token(), to.as_str().to_owned()).await?))
}
