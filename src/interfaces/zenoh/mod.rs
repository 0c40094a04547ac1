//! Zenoh: states, telemetry and events as publications, commands as queries, FAST STOP as a put, and the fleet.
//!
//! | key below `wsg/v1/{gateway}` | use |
//! | --- | --- |
//! | `/{gripper}/state`, `/telemetry`, `/event` | publications; also `/event` without a gripper |
//! | `/{gripper}/state`, `/info` | queries |
//! | `/{gripper}/command/{name}` | queries, named like WebSocket methods: `grip`, `lease.take` |
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
mod publications;
mod queries;

use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tokio_util::task::AbortOnDropHandle;
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::Queryable;

use self::clients::Clients;
pub use self::connectivity::Connectivity;
use self::fast_stop::FastStops;
use self::publications::Publications;
use self::queries::Queries;
use crate::fleet::Peers;
use crate::fleet::keys::ZenohKeys;
use crate::interfaces::Context;

/// First and longest pause before Zenoh is opened again after a failure.
const OPENED_AGAIN_AFTER: Duration = Duration::from_millis(250);
const OPENED_AGAIN_AT_LEAST_EVERY: Duration = Duration::from_secs(30);

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
        Ok(mut declared) => {
            tokio::select! {
                biased;
                () = context.closing.cancelled() => {}
                () = connectivity.watch(&session, &context.gateway.peers, opened) => {}
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

/// Opens a session, retrying until it succeeds.
async fn open_at_last(connectivity: &Connectivity, network: &Peers) -> zenoh::Session {
    let mut again_after = OPENED_AGAIN_AFTER;
    loop {
        match open(connectivity).await {
            Ok(session) => return session,
            Err(error) => connectivity::say(network, Some(format!("Zenoh could not be opened: {error}"))),
        }
        tokio::time::sleep(again_after).await;
        again_after = (again_after * 2).min(OPENED_AGAIN_AT_LEAST_EVERY);
    }
}

/// Opens a session that listens on all endpoints. If that fails, opens one that retries them in the background: there,
/// Zenoh 1.10 can lose a listener from its list of locators, if it adds the listener while it opens the session.
async fn open(connectivity: &Connectivity) -> zenoh::Result<zenoh::Session> {
    if let Some(config) = connectivity.without_retries()
        && let Ok(session) = open_with(config).await
    {
        return Ok(session);
    }
    open_with(connectivity.config.clone()).await
}

/// Opens a session on its own thread. Zenoh can block forever while it waits for a router, so shutdown does not wait
/// for this thread.
async fn open_with(config: zenoh::Config) -> zenoh::Result<zenoh::Session> {
    let (send, opened) = oneshot::channel();
    std::thread::Builder::new().name("zenoh-open".to_owned()).spawn(move || {
        // The receiver may be gone by now.
        let _ = send.send(zenoh::open(config).wait());
    })?;
    opened.await?
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
            let publications = Publications::declare(session, &self.keys, &handle).await?;
            let publishing = context.runtimes.observers.spawn(publications.tell(context.clone(), self.max_hz));
            let publishing = AbortOnDropHandle::new(publishing);
            self.grippers.push(GripperDeclarations { handle, _queryables: queryables, _publishing: publishing });
        }
        Ok(())
    }
}

/// Declares all keys of the gateway.
async fn declare(session: &zenoh::Session, context: &Context, max_hz: u32) -> zenoh::Result<Declarations> {
    let Context { gateway, runtimes, metrics, .. } = context;
    let keys = ZenohKeys::of(&gateway.name);
    // FAST STOP comes first, since fingers can already be moving.
    FastStops::new(gateway.grippers.clone(), runtimes.accept.clone()).declare(session, &keys).await?;
    let clients = Arc::new(Clients::new(keys.clone(), Handle::current(), metrics.clone()));
    clients.declare(session).await?;
    let alive = gateway.peers.join(session).await?;
    let queries = Arc::new(Queries::new(keys.clone(), gateway, clients, metrics.clone()));
    queries.declare(session).await?;
    let mut tasks = JoinSet::new();
    tasks.spawn(gateway.peers.watch_twins(session));
    tasks.spawn_on(publications::tell_events(session.clone(), keys.clone(), context.clone()), &runtimes.observers);
    let mut declared = Declarations { keys, queries, grippers: Vec::new(), max_hz, alive, _tasks: tasks };
    declared.declare_grippers(session, context).await?;
    // Others see the gateway only now that it answers.
    declared.alive.push(session.liveliness().declare_token(declared.keys.own("alive")).await?);
    Ok(declared)
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use serde_json::json;

    use super::*;

    /// A configuration that retries endpoints in the background, like the gateway's.
    fn connectivity(listen: &[&str], connect: &[&str]) -> Connectivity {
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("listen/endpoints", json!(listen)),
            ("listen/exit_on_failure", json!(false)),
            ("listen/timeout_ms", json!(-1)),
            ("listen/retry", json!({"period_init_ms": 10, "period_max_ms": 10})),
            ("connect/endpoints", json!(connect)),
            ("connect/exit_on_failure", json!(false)),
            ("connect/timeout_ms", json!(-1)),
            ("scouting/multicast/enabled", json!(false)),
        ] {
            config.insert_json5(key, &value.to_string()).unwrap();
        }
        let owned = |endpoints: &[&str]| endpoints.iter().map(|&endpoint| endpoint.to_owned()).collect();
        Connectivity { config, listen: owned(listen), connect: owned(connect) }
    }

    fn endpoint(listener: &TcpListener) -> String {
        format!("tcp/{}", listener.local_addr().unwrap())
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn opened_session_listens_at_once() {
        let connectivity = connectivity(&["tcp/127.0.0.1:0"; 20], &[]);
        for _ in 0..10 {
            let session = open(&connectivity).await.unwrap();
            assert_eq!(session.info().locators().await.len(), 20);
            session.close().await.unwrap();
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn free_endpoint_is_open_while_a_taken_one_is_retried() {
        let [taken, free, silent] = std::array::from_fn(|_| TcpListener::bind("127.0.0.1:0").unwrap());
        let (first, second, connect) = (endpoint(&free), endpoint(&taken), endpoint(&silent));
        drop(free);
        let connectivity = connectivity(&[&first, &second], &[&connect]);
        let session = open(&connectivity).await.unwrap();
        let listens_on = async |wanted: &str| {
            let looks = async {
                while !session.info().locators().await.iter().any(|locator| locator.to_string() == wanted) {
                    tokio::time::sleep(Duration::from_millis(10)).await;
                }
            };
            tokio::time::timeout(Duration::from_secs(10), looks).await.unwrap();
        };
        listens_on(&first).await;
        drop(taken);
        listens_on(&second).await;
        // Otherwise Zenoh waits 10 s for it.
        drop(silent);
    }
}
