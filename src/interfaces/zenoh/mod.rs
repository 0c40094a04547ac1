//! Zenoh: states, telemetry and events as publications, commands as queries, FAST STOP as a put, and the fleet.
//!
//! | key below `wsg/v1/{gateway}` | use |
//! | --- | --- |
//! | `/{gripper}/state`, `/telemetry`, `/event` | publications; also `/event` without a gripper |
//! | `/{gripper}/state`, `/info` | queries |
//! | `/{gripper}/command/{name}` | queries, named like WebSocket methods: `grip`, `lease.take` |
//! | `/command/{name}`, `/events`, `/grips`, `/readiness` | queries to the gateway itself |
//! | `/{gripper}/alive` | a liveliness token while the gripper's link is up; `/alive` while the gateway runs |
//! | `/instance/{id}` | a unique liveliness token of this gateway: two of them mean two gateways of one name |
//! | `/dashboard/{url}` | a liveliness token with the percent-encoded URL of the dashboard, if one is configured |
//! | `/client/{name}` | a liveliness token of a client: binds a lease if the client's session is not visible |
//! | `/fast-stop` | a put stops all grippers of the gateway; a put to `wsg/v1/fast-stop` those of all gateways |
//! | `/fleet` | a query: all grippers of all gateways |
//!
//! Zenoh can block on a client that reads nothing, for as long as its configuration allows. So no call into Zenoh runs
//! on a thread that others wait for: commands run where those of HTTP do, but replies and publications are sent from
//! other threads. A FAST STOP passes through none of these queues.

mod client;
mod clients;
mod connectivity;
mod fast_stop;
mod open;
mod payloads;
mod publications;
mod queries;
mod servo;

use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::task::JoinSet;
use tokio_util::task::AbortOnDropHandle;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::Queryable;

use self::clients::Clients;
pub use self::connectivity::Connectivity;
use self::fast_stop::FastStops;
use self::open::OpenSession;
use self::publications::Publications;
use self::queries::Queries;
use self::servo::ServoTargets;
use crate::fleet::keys::ZenohKeys;
use crate::interfaces::Context;

/// Time limit for closing the session.
const FAREWELL_WITHIN: Duration = Duration::from_secs(1);

#[derive(Debug, Clone)]
pub struct ZenohSettings {
    pub connectivity: Connectivity,
    /// Maximum rate of states and telemetry for each gripper, per second.
    pub max_hz: u32,
}

/// Serves Zenoh until the gateway closes, retrying until a session opens. The other interfaces run meanwhile. Calls
/// `opened` with the addresses that Zenoh listens on.
pub async fn serve(settings: ZenohSettings, context: Context, opened: impl FnMut(&[String])) {
    let ZenohSettings { connectivity, max_hz } = settings;
    let OpenSession { session, listens_everywhere } = tokio::select! {
        biased;
        () = context.closing.cancelled() => return,
        open = OpenSession::open(&connectivity, &context.gateway.peers) => open,
    };
    let declared = tokio::select! {
        biased;
        () = context.closing.cancelled() => return,
        declared = declare(&session, &context, max_hz) => declared,
    };
    match declared {
        Ok(mut declared) => {
            tokio::select! {
                biased;
                () = context.closing.cancelled() => {}
                () = connectivity.watch(&session, listens_everywhere, &context.gateway.peers, opened) => {}
                () = declared.follow_grippers(&session, &context) => {}
            }
        }
        Err(error) => {
            tracing::error!(%error, "Zenoh declarations failed: the gateway runs without Zenoh");
            context.gateway.peers.set_cause(Some(format!("Zenoh declarations failed: {error}")));
        }
    }
    if tokio::time::timeout(FAREWELL_WITHIN, session.close()).await.is_err() {
        tracing::warn!("Zenoh session did not close within {FAREWELL_WITHIN:?}");
    }
}

/// The gateway's declarations, which end when this is dropped.
struct Declarations {
    keys: ZenohKeys,
    queries: Arc<Queries>,
    grippers: Vec<GripperDeclarations>,
    max_hz: u32,
    alive: Vec<LivelinessToken>,
    _tasks: JoinSet<()>,
}

/// The declarations of one gripper.
struct GripperDeclarations {
    handle: crate::gripper::Handle,
    _queryables: [Queryable<()>; 3],
    _targets: ServoTargets,
    _publishing: AbortOnDropHandle<()>,
}

impl Declarations {
    /// Follows the grippers that a reload adds and removes. Never returns.
    async fn follow_grippers(&mut self, session: &zenoh::Session, context: &Context) {
        let mut changes = context.gateway.grippers.changes();
        loop {
            // The grippers can have changed before this subscribed to their changes.
            if let Err(error) = self.declare_grippers(session, context).await {
                tracing::error!(%error, "Zenoh declarations failed: some grippers cannot be reached via Zenoh");
            }
            changes.wait().await;
        }
    }

    async fn declare_grippers(&mut self, session: &zenoh::Session, context: &Context) -> zenoh::Result<()> {
        let current = context.gateway.grippers.all();
        self.grippers.retain(|declared| current.iter().any(|handle| handle.is_same(&declared.handle)));
        for handle in current {
            if self.grippers.iter().any(|declared| handle.is_same(&declared.handle)) {
                continue;
            }
            let queryables = self.queries.declare_gripper(session, handle.name()).await?;
            let targets = ServoTargets::declare(session, &self.keys, context, handle.name()).await?;
            let publications = Publications::declare(session, &self.keys, &handle).await?;
            let publishing = context.runtimes.publications.spawn(publications.run(context.clone(), self.max_hz));
            let publishing = AbortOnDropHandle::new(publishing);
            self.grippers.push(GripperDeclarations {
                handle,
                _queryables: queryables,
                _targets: targets,
                _publishing: publishing,
            });
        }
        Ok(())
    }
}

/// Declares all keys of the gateway.
async fn declare(session: &zenoh::Session, context: &Context, max_hz: u32) -> zenoh::Result<Declarations> {
    let Context { gateway, runtimes, metrics, .. } = context;
    let keys = ZenohKeys::of(&gateway.name);
    // FAST STOP comes first, since fingers can already be moving.
    let stops = FastStops::new(gateway.grippers.clone(), runtimes.accept.clone(), metrics.clone());
    stops.declare(session, &keys).await?;
    let clients = Arc::new(Clients::new(keys.clone(), Handle::current(), metrics.clone(), gateway.access.clone()));
    clients.declare(session).await?;
    let alive = gateway.peers.join(session).await?;
    let queries = Arc::new(Queries::new(keys.clone(), gateway, clients.clone(), metrics.clone()));
    queries.declare(session).await?;
    let mut tasks = JoinSet::new();
    tasks.spawn(clients.check_rights());
    tasks.spawn(gateway.peers.watch_twins(session));
    tasks.spawn_on(publications::publish_events(session.clone(), keys.clone(), context.clone()), &runtimes.observers);
    let mut declared = Declarations { keys, queries, grippers: Vec::new(), max_hz, alive, _tasks: tasks };
    declared.declare_grippers(session, context).await?;
    // Others see the gateway only now that it answers.
    declared.alive.push(session.liveliness().declare_token(declared.keys.own("alive")).await?);
    Ok(declared)
}
