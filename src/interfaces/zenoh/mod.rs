//! Zenoh: states, telemetry and events as publications, commands as queries, FAST STOP as a put, and the fleet.
//!
//! | key, below `wsg/v1/{gateway}` | what it is |
//! | --- | --- |
//! | `/{gripper}/state`, `/telemetry`, `/event` | publications of what HTTP and WebSocket tell; `/event` without a gripper, too |
//! | `/{gripper}/state`, `/info` | queries |
//! | `/{gripper}/command/{name}` | queries, by the names that WebSocket has: `grip`, `lease.take` |
//! | `/{gripper}/alive` | a liveliness token while the gripper's link is up; `/alive` while the gateway is |
//! | `/instance/{id}` | a liveliness token of the gateway that is this one's alone: two of them are two gateways of one name |
//! | `/client/{name}` | a liveliness token of a client, which a lease is bound to where its session can't be seen |
//! | `/fast-stop` | a put stops all grippers of the gateway; one to `wsg/v1/fast-stop` those of all gateways |
//! | `/fleet` | a query: all grippers of all gateways |
//!
//! Zenoh may wait for a client that takes nothing, for as long as its configuration says. So nothing here runs where
//! somebody else waits: commands are worked off where those of HTTP are, but replies and publications are sent from
//! elsewhere. A FAST STOP passes none of that.

mod client;
mod clients;
mod connectivity;
mod fast_stop;
mod publications;
mod queries;

use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;

use self::clients::Clients;
pub use self::connectivity::Connectivity;
use self::fast_stop::FastStops;
use self::publications::Publications;
use self::queries::Queries;
use crate::fleet::Peers;
use crate::fleet::keys::Keys;
use crate::interfaces::Context;

/// After how long Zenoh is opened again that could not be, at first and at most.
const OPENED_AGAIN_AFTER: Duration = Duration::from_millis(250);
const OPENED_AGAIN_AT_LEAST_EVERY: Duration = Duration::from_secs(30);

/// How long a farewell may take.
const FAREWELL_WITHIN: Duration = Duration::from_secs(1);

/// How the gateway is on a Zenoh network.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Where it is to be reached.
    pub connectivity: Connectivity,
    /// How often states and telemetry are published at most, a second and gripper.
    pub max_hz: u32,
}

/// Serves until the gateway closes. Where Zenoh can't be had, the gateway is served without until it can; `opened` is told
/// where others find it.
pub async fn serve(settings: Settings, context: Context, opened: impl FnMut(&[String])) {
    let Settings { connectivity, max_hz } = settings;
    let session = tokio::select! {
        biased;
        () = context.closing.cancelled() => return,
        session = open_at_last(&connectivity, &context.gateway.peers) => session,
    };
    let declared = tokio::select! {
        biased;
        () = context.closing.cancelled() => return,
        declared = declare(&session, &context, max_hz) => declared,
    };
    match declared {
        Ok((_alive, _told)) => {
            tokio::select! {
                biased;
                () = context.closing.cancelled() => {}
                () = connectivity.watch(&session, &context.gateway.peers, opened) => {}
            }
        }
        Err(error) => {
            tracing::error!(%error, "Zenoh declares nothing: the grippers are served without it");
            context.gateway.peers.set_cause(Some(format!("Zenoh declares nothing: {error}")));
        }
    }
    if tokio::time::timeout(FAREWELL_WITHIN, session.close()).await.is_err() {
        tracing::warn!("Zenoh did not end within {FAREWELL_WITHIN:?}");
    }
}

/// Opens a session, and tries again where that fails.
async fn open_at_last(connectivity: &Connectivity, network: &Peers) -> zenoh::Session {
    let mut again_after = OPENED_AGAIN_AFTER;
    loop {
        match open(connectivity.config.clone()).await {
            Ok(session) => return session,
            Err(error) => connectivity::say(network, Some(format!("Zenoh can't be opened: {error}"))),
        }
        tokio::time::sleep(again_after).await;
        again_after = (again_after * 2).min(OPENED_AGAIN_AT_LEAST_EVERY);
    }
}

/// Opens a session. It may wait for a router for ever, and not as futures do: so it has a thread of its own, which nobody
/// waits for when the gateway ends.
async fn open(config: zenoh::Config) -> zenoh::Result<zenoh::Session> {
    let (send, opened) = oneshot::channel();
    std::thread::Builder::new().name("zenoh-open".to_owned()).spawn(move || {
        // Whoever asked may have ended meanwhile.
        let _ = send.send(zenoh::open(config).wait());
    })?;
    opened.await?
}

/// Everything that the gateway is to others; it ends with what is returned.
async fn declare(
    session: &zenoh::Session,
    context: &Context,
    max_hz: u32,
) -> zenoh::Result<([LivelinessToken; 2], JoinSet<()>)> {
    let Context { gateway, runtimes, metrics, .. } = context;
    let keys = Keys::of(&gateway.name);
    // First: it stops what may be moving already.
    FastStops::new(gateway.grippers.clone(), runtimes.accept.clone()).declare(session, &keys).await?;
    let clients = Arc::new(Clients::new(keys.clone(), Handle::current(), metrics.clone()));
    clients.declare(session).await?;
    let instance = gateway.peers.join(session).await?;
    let queries = Queries::new(keys.clone(), gateway, clients, metrics.clone());
    Arc::new(queries).declare(session, &gateway.grippers).await?;
    let mut told = JoinSet::new();
    told.spawn(gateway.peers.watch_twins(session));
    for handle in gateway.grippers.iter() {
        let publications = Publications::declare(session, &keys, handle).await?;
        told.spawn_on(publications.tell(context.clone(), max_hz), &runtimes.observers);
    }
    told.spawn_on(publications::tell_events(session.clone(), keys.clone(), context.clone()), &runtimes.observers);
    Ok(([instance, session.liveliness().declare_token(keys.own("alive")).await?], told))
}
