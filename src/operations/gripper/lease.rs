//! The lease, which entitles one client to move the gripper.

use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;
use utoipa::ToSchema;

use crate::access::Right;
use crate::fleet::keys::MAX_SUBJECT_BYTES;
use crate::gripper::{AcquiredLease, Conflict, Rejection};
use crate::model::lease::{MAX_TTL, MIN_TTL};
use crate::model::{Lease, OnLossHolding, OnLossMoving, TakeLease, Urgency};
use crate::operations::calls::call::{Call, Leased, NoFields};
use crate::operations::calls::connection_lease::ConnectionLease;
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::{Effect, Json, OrWaiting};
use crate::operations::parameters::values::{LeaseField, Whole, name, text};
use crate::operations::problem::Problem;

operations! {
    /// Get the lease
    ///
    /// Returns the lease holder and the remaining time. While nobody holds the lease, any client may move the gripper,
    /// one command at a time.
    GET = GET "/grippers/{gripper}/lease" as "lease" {
        run: get, id: "get_lease", tag: "lease", problems: COMMAND,
        answer: "The lease, without its token",
    };

    /// Take the lease
    ///
    /// Returns a token; send it with every further command. Each use of the token renews the lease, and an open request
    /// with it keeps the lease alive. A holder that stays silent for `ttl_ms` counts as lost; `on_loss_moving` and
    /// `on_loss_holding` say what the gripper does then.
    ///
    /// A client that has lost its token gets its lease back with the same `holder` and the same credential or address.
    /// This is refused until the lease has not been used for half its time to live, while a motion runs, while a part
    /// is held and `on_loss_holding` is `fast_stop`, and while a request or connection of the holder is open.
    TAKE = POST "/grippers/{gripper}/lease" as "lease.take" {
        run: take, id: "take_lease", tag: "lease", problems: LEASE,
        answer: "The lease, with its token",
    };

    /// Renew the lease
    RENEW = PUT "/grippers/{gripper}/lease" as "lease.renew" {
        run: renew, id: "renew_lease", tag: "lease", problems: LEASE,
        answer: "The lease, renewed",
    }.urgent(Urgency::Lease);

    /// Release the lease
    ///
    /// Stops a running motion and latches nothing. A lease that the caller no longer holds is left unchanged.
    RELEASE = DELETE "/grippers/{gripper}/lease" as "lease.release" {
        run: release, id: "release_lease", tag: "lease", problems: COMMAND,
        answer: "The current lease",
    }.urgent(Urgency::Lease);

    /// Hand the lease over
    ///
    /// Passes the lease to the client in `requested_by`, which gets its own token when it requests the lease again. A
    /// running motion continues.
    HAND_OVER = POST "/grippers/{gripper}/lease/hand-over" as "lease.hand-over" {
        run: hand_over, id: "hand_over_lease", tag: "lease", problems: LEASE,
        answer: "The current lease",
    };
}

type LeaseResult = Result<Json<Lease>, Problem>;

async fn get(call: Call<NoFields>) -> LeaseResult {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    Ok(Json(gripper.handle.lease().await?))
}

/// Time to live of a lease, in ms.
type TimeToLive = Whole<{ MIN_TTL.as_millis() as u64 }, { MAX_TTL.as_millis() as u64 }>;

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
    ttl_ms: Option<TimeToLive>,
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
    lease: Option<LeaseField>,
}

async fn take(call: Call<Take>) -> Result<OrWaiting<Lease>, Problem> {
    let (gripper, body): (_, Take) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    if body.force {
        call.require(Right::Supervise)?;
    }
    let holder = body.holder.as_deref().filter(|holder| !holder.is_empty());
    let take = TakeLease {
        holder: holder.map(|given| name("holder", given)).transpose()?,
        ttl: body.ttl_ms.map(|ttl_ms| ttl_ms.checked("ttl_ms")).transpose()?.map(Duration::from_millis),
        on_loss_moving: body.on_loss_moving,
        on_loss_holding: body.on_loss_holding,
        force: body.force,
        request: body.request,
        token: gripper.token(),
        client: gripper.client,
    };
    let handle = gripper.handle;
    let has_ttl = take.ttl.is_some();
    let taken = match handle.take_lease(take).await {
        Err(Rejection::Conflict(Conflict::LeaseRequested { place, .. })) => {
            let lease = Lease { place: Some(place), ..handle.lease().await? };
            return OrWaiting::new(&lease, Effect::Waiting);
        }
        taken => taken?,
    };
    let AcquiredLease { lease, times_taken, keep } = taken;
    let keep = keep.filter(|_| !has_ttl);
    let leased = ConnectionLease::new(handle, &lease, times_taken, keep);
    OrWaiting::new(&lease, leased.map_or(Effect::None, |lease| Effect::Leased(Arc::new(lease))))
}

async fn renew(call: Call<Leased>) -> LeaseResult {
    let gripper = call.leased()?;
    Ok(Json(gripper.handle.renew_lease(gripper.token()).await?))
}

async fn release(call: Call<Leased>) -> LeaseResult {
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
    lease: Option<LeaseField>,
}

async fn hand_over(call: Call<HandOver>) -> LeaseResult {
    let (gripper, body): (_, HandOver) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    let to = text::<MAX_SUBJECT_BYTES>("to", &body.to)?;
    Ok(Json(gripper.handle.hand_over(gripper.token(), to.as_str().to_owned()).await?))
}
