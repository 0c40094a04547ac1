//! The gateways of one Zenoh network, as this one sees them: the newest states of their grippers, and requests to
//! them.
//!
//! Architecture invariant: nothing here decides about another gateway's gripper. A request goes to the gateway that
//! owns the gripper, and the answer comes back unchanged.

pub mod keys;
mod name_conflicts;
mod other_grippers;
mod reply_bounds;
mod report;
mod requests;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{Notify, Semaphore, watch};
use tokio::task::AbortHandle;
use url::Url;
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::sample::{Locality, Sample, SampleKind};

use self::keys::{FAST_STOP_OF_ALL, ROOT, ZenohKeys, last_part};
use self::name_conflicts::Twins;
use self::other_grippers::{Others, PeerStop};
use self::reply_bounds::{MAX_COLLECTIONS, ReplyRoom};
use crate::gripper::{Grippers, Now};
use crate::model::{Client, FastStopId, Name, Reason, State};

pub use other_grippers::{KEPT_FOR, MAX_URL_BYTES, parse_dashboard};
pub use reply_bounds::CollectedRoom;
pub use report::FleetGripper;
pub use requests::{EVENTS, GRIPS, NoAnswer, PeerRequest, PeerResponse, READINESS, TOKEN};

/// Maximum number of concurrent requests to other gateways. The limit applies separately to stops, to lease requests,
/// and to all others.
const MAX_ASKS: usize = 64;

/// Longest wait for the confirmations of other gateways' grippers: as long as for own grippers, and as long again for
/// the network.
const FAST_STOP_WAIT: Duration = crate::gripper::handle::FAST_STOP_WAIT.saturating_mul(2);

/// Shortest interval between queries for confirmations, shared by all FAST STOPs.
const ASKS_EVERY: Duration = Duration::from_millis(25);

/// Interval and duration of repeating a FAST STOP to a gateway that missed it, because it was frozen or its router was
/// away. After that, somebody could be working there again without knowing of the FAST STOP.
const REPEATED_EVERY: Duration = Duration::from_millis(250);
const REPEATED_FOR: Duration = Duration::from_mins(1);

/// Largest accepted state of another gateway, in bytes.
const MAX_STATE_BYTES: usize = 16 * 1024;

/// The network, as seen by one gateway.
#[derive(Debug)]
pub struct Peers {
    gateway: Name,
    own: Grippers,
    /// URL of this gateway's dashboard, as others reach it.
    dashboard: Option<Url>,
    session: OnceLock<zenoh::Session>,
    /// Why the gateway is not connected to the network as configured; `None` if it is.
    cause: watch::Sender<Option<String>>,
    others: Mutex<Others>,
    twins: Arc<Twins>,
    /// Notified when another gateway has answered.
    news: Notify,
    /// When the other gateways were last asked for their states.
    asked_at: Mutex<Option<Instant>>,
    asks: Arc<Semaphore>,
    stops: Arc<Semaphore>,
    leases: Arc<Semaphore>,
    collections: Arc<Semaphore>,
    reply_room: ReplyRoom,
    /// Task that repeats the newest FAST STOP of all gateways to those that missed it.
    repeating: Mutex<Option<AbortHandle>>,
}

/// A FAST STOP of all gateways.
#[derive(Debug)]
pub struct FleetStop {
    /// Id to name in the acknowledgement of this gateway's own grippers.
    pub id: FastStopId,
    /// Each gripper, as gateway/gripper, and whether it has confirmed.
    pub stops: Vec<(String, bool)>,
    /// Whether these are the grippers of all gateways: the network is connected as configured, and each gateway that is
    /// alive has reported its grippers.
    pub is_complete: bool,
}

impl Peers {
    /// Returns the peers of a gateway that has not joined a network yet.
    #[must_use]
    pub fn new(gateway: Name, own: Grippers, dashboard: Option<Url>) -> Self {
        let session = OnceLock::new();
        let others = Mutex::default();
        let news = Notify::new();
        let [asks, stops, leases] = [MAX_ASKS; 3].map(|places| Arc::new(Semaphore::new(places)));
        let cause = watch::Sender::new(None);
        let twins = Arc::default();
        let asked_at = Mutex::default();
        let repeating = Mutex::default();
        let collections = Arc::new(Semaphore::new(MAX_COLLECTIONS));
        let reply_room = ReplyRoom::default();
        Self {
            gateway,
            own,
            dashboard,
            session,
            cause,
            others,
            twins,
            news,
            asked_at,
            asks,
            stops,
            leases,
            collections,
            reply_room,
            repeating,
        }
    }

    /// Joins the network of this session, until the returned tokens are dropped.
    ///
    /// # Errors
    /// Zenoh's error.
    pub async fn join(self: &Arc<Self>, session: &zenoh::Session) -> zenoh::Result<Vec<LivelinessToken>> {
        self.follow_others(session).await?;
        let keys = ZenohKeys::of(&self.gateway);
        Twins::answer(session, &keys).await?;
        let instance = keys.own(&format!("instance/{}", session.zid()));
        let mut tokens = vec![session.liveliness().declare_token(instance).await?];
        if let Some(url) = &self.dashboard {
            let key = keys.own(&format!("dashboard/{}", keys::encoded(url.as_str())));
            match session.liveliness().declare_token(key).await {
                Ok(token) => tokens.push(token),
                Err(error) => tracing::warn!(%error, "URL of the dashboard not sent to other gateways"),
            }
        }
        // A gateway that has joined before keeps its session.
        let _ = self.session.set(session.clone());
        Ok(tokens)
    }

    /// Subscribes to the states of all grippers, and to the presence and the dashboards of all gateways.
    async fn follow_others(self: &Arc<Self>, session: &zenoh::Session) -> zenoh::Result<()> {
        let network = self.clone();
        let states = session.declare_subscriber(format!("{ROOT}/*/*/state")).allowed_origin(Locality::Remote);
        let states = states.callback(move |state: Sample| {
            network.take_state(state.key_expr().as_str(), &state.payload().to_bytes());
        });
        states.background().await?;
        let network = self.clone();
        let gateways = session.liveliness().declare_subscriber(format!("{ROOT}/*/alive")).history(true);
        let gateways = gateways.callback(move |token: Sample| {
            network.take_token(token.key_expr().as_str(), token.kind() == SampleKind::Put);
        });
        gateways.background().await?;
        let network = self.clone();
        let own = session.zid().to_string();
        let instances = session.liveliness().declare_subscriber(format!("{ROOT}/*/instance/*")).history(true);
        let instances = instances.callback(move |token: Sample| {
            let key = token.key_expr().as_str();
            let is_alive = token.kind() == SampleKind::Put;
            if last_part(key) != own {
                network.take_instance(key, is_alive);
            }
        });
        instances.background().await?;
        let network = self.clone();
        let dashboards = session.liveliness().declare_subscriber(format!("{ROOT}/*/dashboard/*")).history(true);
        let dashboards = dashboards.callback(move |token: Sample| {
            network.take_dashboard(token.key_expr().as_str(), token.kind() == SampleKind::Put);
        });
        dashboards.background().await
    }

    /// Looks for other gateways with this one's name, for as long as it is polled.
    pub fn watch_twins(&self, session: &zenoh::Session) -> impl Future<Output = ()> + use<> {
        self.twins.clone().watch(session.clone(), ZenohKeys::of(&self.gateway))
    }

    /// Sets why the gateway is not connected as configured; `None` if it is.
    pub fn set_cause(&self, cause: Option<String>) {
        self.cause.send_replace(cause);
    }

    /// Why the gateway is not connected as configured; `None` if it is, or if Zenoh is off.
    #[must_use]
    pub fn cause(&self) -> watch::Receiver<Option<String>> {
        self.cause.subscribe()
    }

    /// All grippers of all gateways, by gateway and name.
    #[must_use]
    pub fn grippers(&self) -> Vec<FleetGripper> {
        let own = self.own.all().into_iter().filter_map(|handle| self.of_own(&handle.state()));
        let mut all: Vec<_> = own.chain(self.others().grippers(Now::read().instant)).collect();
        all.sort_by_cached_key(FleetGripper::name);
        all
    }

    /// All other gateways, and whether each is gone.
    #[must_use]
    pub fn gateways(&self) -> BTreeMap<Name, bool> {
        self.others().gateways(Now::read().instant)
    }

    /// Whether a gateway is this one.
    #[must_use]
    pub fn is_own(&self, gateway: &Name) -> bool {
        self.gateway == *gateway
    }

    /// Whether another gateway has the same name, so that a request to either reaches both.
    #[must_use]
    pub fn has_twin(&self) -> bool {
        self.twins.any()
    }

    /// Why motions over Zenoh are refused; `None` if they are not.
    #[must_use]
    pub fn why_no_motions(&self) -> Option<String> {
        const WHY: &str = "another gateway on the Zenoh network has the same name, so motions over Zenoh are refused: \
                           give each gateway its own --name";
        self.has_twin().then(|| WHY.to_owned())
    }

    /// Stops the grippers of all gateways. This gateway's own grippers wait neither for the others nor for Zenoh. For
    /// a minute, the FAST STOP is repeated to gateways that missed it, and sent to those that appear if some were out of
    /// reach.
    pub async fn fast_stop(self: &Arc<Self>, client: &Client, reason: &Reason) -> FleetStop {
        let begun = Now::read().instant;
        let payload = serde_json::json!({"reason": reason.as_str(), "client": &*client.subject}).to_string();
        let ((id, own), ()) = tokio::join!(self.own.fast_stop(client, reason), self.stop_others(begun, &payload));
        // If several gateways share this name, it is unknown which of them has confirmed.
        let is_one = !self.has_twin();
        let own = own.into_iter();
        let own = own.map(|(gripper, confirmed)| (format!("{}/{gripper}", self.gateway), confirmed && is_one));
        let others = self.others().stops_since(begun);
        let is_complete = self.is_complete();
        let has_open = others.values().any(|stop| !stop.has_arrived());
        if has_open || !is_complete {
            let repeating = tokio::spawn(self.clone().repeat_fast_stop(begun, payload, is_complete));
            // The newest task covers all open grippers.
            if let Some(before) = self.repeating().replace(repeating.abort_handle()) {
                before.abort();
            }
        }
        let others = others.into_iter().map(|((gateway, gripper), stop)| {
            let is_confirmed = stop == PeerStop::Confirmed;
            (format!("{gateway}/{gripper}"), is_confirmed)
        });
        FleetStop { id, stops: own.chain(others).collect(), is_complete }
    }

    /// Whether all gateways of the network can be reached and have reported their grippers, as far as known.
    fn is_complete(&self) -> bool {
        self.cause.borrow().is_none() && !self.others().has_unreported()
    }

    /// Sends the FAST STOP to the others, and queries them until all that are alive have confirmed.
    async fn stop_others(self: &Arc<Self>, begun: Instant, payload: &str) {
        self.put_fast_stop(FAST_STOP_OF_ALL.to_owned(), payload.to_owned());
        let confirmed = async {
            loop {
                let news = self.news.notified();
                let stops = self.others().stops_since(begun);
                if stops.values().all(|stop| matches!(stop, PeerStop::Confirmed | PeerStop::Gone)) {
                    return;
                }
                self.ask_states();
                // Without an answer, the query is repeated.
                let _ = tokio::time::timeout(ASKS_EVERY, news).await;
            }
        };
        // Grippers that have not confirmed by then are reported as unconfirmed.
        let _ = tokio::time::timeout(FAST_STOP_WAIT, confirmed).await;
    }

    /// Repeats a FAST STOP to gateways that do not know of it, until the gateways of all grippers do. If some may have
    /// been out of reach, others can still appear after the network is connected.
    async fn repeat_fast_stop(self: Arc<Self>, begun: Instant, payload: String, was_complete: bool) {
        // A gripper of `arrived` can have been acknowledged since.
        let mut arrived = BTreeSet::new();
        let mut open = BTreeSet::new();
        let repeated = async {
            let mut ticks = tokio::time::interval(REPEATED_EVERY);
            loop {
                let stops = self.others().stops_since(begun);
                arrived.extend(stops.iter().filter(|(_, stop)| stop.has_arrived()).map(|(name, _)| name.clone()));
                open = stops.keys().filter(|name| !arrived.contains(*name)).cloned().collect();
                if open.is_empty() && was_complete {
                    return;
                }
                let missed =
                    open.iter().filter(|name| stops.get(*name) == Some(&PeerStop::Unknown { is_missed: true }));
                let gateways: BTreeSet<_> = missed.map(|(gateway, _)| gateway).collect();
                for gateway in gateways {
                    tracing::warn!(%gateway, "gateway missed a FAST STOP: sending it again");
                    self.put_fast_stop(ZenohKeys::of(gateway).own("fast-stop"), payload.clone());
                }
                ticks.tick().await;
                self.ask_states();
            }
        };
        let is_over = tokio::time::timeout(REPEATED_FOR, repeated).await.is_err();
        if is_over && !(open.is_empty() && self.is_complete()) {
            let cause = self.cause.borrow().clone();
            tracing::error!(
                ?open,
                cause,
                "FAST STOP of all gateways not known to have reached these grippers: check them on site"
            );
        }
    }

    /// Queries all other gateways for their grippers' states, unless a query was just sent. Anyone can publish a
    /// state, but an answer is bound to the session that sent it.
    fn ask_states(self: &Arc<Self>) {
        let Some(session) = self.session.get().cloned() else { return };
        let now = Now::read().instant;
        {
            let mut asked_at = self.asked_at.lock().unwrap_or_else(PoisonError::into_inner);
            if asked_at.is_some_and(|asked_at| now.saturating_duration_since(asked_at) < ASKS_EVERY) {
                return;
            }
            *asked_at = Some(now);
        }
        let network = self.clone();
        tokio::task::spawn_blocking(move || {
            let get = session.get(format!("{ROOT}/*/*/state")).target(QueryTarget::All).timeout(FAST_STOP_WAIT);
            let get = get.consolidation(ConsolidationMode::None).allowed_destination(Locality::Remote);
            let get = get.express(true).priority(Priority::RealTime);
            if let Err(error) = get.callback(move |reply| network.take_answer(&reply, now)).wait() {
                tracing::error!(%error, "FAST STOP confirmations not requested from other gateways");
            }
        });
    }

    fn take_answer(&self, reply: &Reply, asked_at: Instant) {
        let Ok(state) = reply.result() else { return };
        let (Some(name), Some(replier)) = (keys::of_gripper(state.key_expr().as_str()), reply.replier_id()) else {
            return;
        };
        let is_bounded = state.payload().len() <= MAX_STATE_BYTES;
        if let Some(report) = is_bounded.then(|| report::PeerReport::of(&state.payload().to_bytes())).flatten() {
            self.others().take_answer(&name, &report, &replier.zid().to_string(), asked_at);
            self.news.notify_waiters();
        }
    }

    /// Publishes a FAST STOP, on a thread that can wait for a place in the queue.
    fn put_fast_stop(&self, key: String, payload: String) {
        let Some(session) = self.session.get().cloned() else { return };
        tokio::task::spawn_blocking(move || {
            let put = session.put(key, payload).allowed_destination(Locality::Remote).express(true);
            let put = put.priority(Priority::RealTime).congestion_control(CongestionControl::Block);
            if let Err(error) = put.wait() {
                tracing::error!(%error, "FAST STOP not sent to other gateways");
            }
        });
    }

    fn repeating(&self) -> MutexGuard<'_, Option<AbortHandle>> {
        self.repeating.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn of_own(&self, state: &State) -> Option<FleetGripper> {
        let report = report::PeerReport::of(&serde_json::to_vec(state).ok()?)?;
        let listed = report.of_gripper(&self.gateway, &state.gripper, Duration::ZERO, false);
        Some(listed.shown_at(self.dashboard.as_ref()))
    }

    fn take_state(&self, key: &str, state: &[u8]) {
        let Some((gateway, gripper)) = keys::of_gripper(key) else { return };
        if gateway != self.gateway
            && state.len() <= MAX_STATE_BYTES
            && let Some(report) = report::PeerReport::of(state)
        {
            self.others().take_state(gateway, gripper, report);
        }
    }

    fn take_token(&self, key: &str, is_alive: bool) {
        if let Some(gateway) = keys::of_gateway(key).filter(|gateway| *gateway != self.gateway) {
            tracing::info!(%gateway, is_alive, "presence of another gateway changed");
            self.others().take_token(gateway, is_alive);
        }
    }

    fn take_dashboard(&self, key: &str, is_alive: bool) {
        if let Some(gateway) = keys::of_gateway(key).filter(|gateway| *gateway != self.gateway) {
            self.others().take_dashboard(gateway, &keys::decoded(last_part(key)), is_alive);
        }
    }

    fn take_instance(&self, key: &str, is_alive: bool) {
        let Some(gateway) = keys::of_gateway(key) else { return };
        if gateway == self.gateway {
            self.twins.look();
            return;
        }
        self.others().take_instance(gateway, last_part(key), is_alive);
    }

    fn others(&self) -> MutexGuard<'_, Others> {
        self.others.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
