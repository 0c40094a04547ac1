//! The gateways of one Zenoh network, as this one sees them: their grippers' newest states, and a way to ask them.
//!
//! Architecture invariant: nothing here decides about another gateway's gripper. What is asked of it goes to the gateway
//! that owns it, and what that answers comes back as it is.

mod ask;
pub mod keys;
mod others;
mod told;

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{Notify, Semaphore};
use zenoh::Wait as _;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::{Locality, Sample, SampleKind};

use self::keys::{FAST_STOP_OF_ALL, ROOT};
use self::others::Others;
use crate::gripper::model::{Client, FastStopId, Name, Reason, State};
use crate::gripper::{Fleet, Now};

pub use ask::{Ask, Asked, NoAnswer};
pub use told::FleetGripper;

/// Requests to other gateways that may be under way.
const MAX_ASKS: usize = 64;

/// How long the confirmations of other gateways' grippers are waited for: as long as for one's own, and as long again for
/// the network.
const FAST_STOP_WAIT: Duration = crate::gripper::handle::FAST_STOP_WAIT.saturating_mul(2);

/// The largest state of another gateway that is looked at, in bytes.
const MAX_STATE_BYTES: usize = 16 * 1024;

/// The network, from one gateway's place.
#[derive(Debug)]
pub struct Network {
    gateway: Name,
    own: Fleet,
    session: OnceLock<zenoh::Session>,
    others: Mutex<Others>,
    /// Told when a state of another gateway has come.
    news: Notify,
    asks: Arc<Semaphore>,
}

/// A FAST STOP of all gateways.
#[derive(Debug)]
pub struct FleetStop {
    /// What an acknowledge of this gateway's own grippers has to name.
    pub id: FastStopId,
    /// By gateway and gripper, whether it has confirmed.
    pub stops: Vec<(String, bool)>,
}

impl Network {
    /// Of the gateway of this name with these grippers, which is on no network yet.
    #[must_use]
    pub fn new(gateway: Name, own: Fleet) -> Self {
        let (session, others, news) = (OnceLock::new(), Mutex::default(), Notify::new());
        Self { gateway, own, session, others, news, asks: Arc::new(Semaphore::new(MAX_ASKS)) }
    }

    /// Goes on the network of this session.
    ///
    /// # Errors
    /// As Zenoh says.
    pub async fn join(self: &Arc<Self>, session: &zenoh::Session) -> zenoh::Result<()> {
        let network = self.clone();
        let told = move |state: Sample| network.take_state(state.key_expr().as_str(), &state.payload().to_bytes());
        let states = session.declare_subscriber(format!("{ROOT}/*/*/state")).allowed_origin(Locality::Remote);
        states.callback(told).background().await?;
        let network = self.clone();
        let lives = move |token: Sample| network.take_token(token.key_expr().as_str(), token.kind() == SampleKind::Put);
        let gateways = session.liveliness().declare_subscriber(format!("{ROOT}/*/alive")).history(true);
        gateways.callback(lives).background().await?;
        // Who is on one already stays there.
        let _ = self.session.set(session.clone());
        Ok(())
    }

    /// All grippers of all gateways, by gateway and name.
    #[must_use]
    pub fn grippers(&self) -> Vec<FleetGripper> {
        let own = self.own.iter().filter_map(|handle| self.of_own(&handle.state()));
        let mut all: Vec<_> = own.chain(self.others().grippers(Now::read().instant)).collect();
        all.sort_by(|one, other| one.name().cmp(&other.name()));
        all
    }

    /// Whether a gateway is this one.
    #[must_use]
    pub fn is_own(&self, gateway: &Name) -> bool {
        self.gateway == *gateway
    }

    /// Whether another gateway has the name of this one: what is asked of either goes to both.
    #[must_use]
    pub fn has_twin(&self) -> bool {
        self.others().has_twin()
    }

    /// Stops the grippers of all gateways. Its own don't wait for the others, nor for Zenoh.
    pub async fn fast_stop(&self, client: &Client, reason: &Reason) -> FleetStop {
        let begun = Now::read().instant;
        let ((id, own), ()) = tokio::join!(self.own.fast_stop(client, reason), self.stop_others(begun, reason));
        let own = own.into_iter().map(|(gripper, confirmed)| (format!("{}/{gripper}", self.gateway), confirmed));
        let others = self.others().stopped_since(begun);
        FleetStop { id, stops: own.chain(others).collect() }
    }

    /// Tells the others, and waits until all of them that live have confirmed.
    async fn stop_others(&self, begun: Instant, reason: &Reason) {
        let Some(session) = self.session.get().cloned() else { return };
        let reason = serde_json::json!({"reason": reason.as_str()}).to_string();
        // It may wait for a place, and this must not.
        tokio::task::spawn_blocking(move || {
            let put = session.put(FAST_STOP_OF_ALL, reason).allowed_destination(Locality::Remote).express(true);
            let put = put.priority(Priority::RealTime).congestion_control(CongestionControl::Block);
            if let Err(error) = put.wait() {
                tracing::error!(%error, "the other gateways are not told of a FAST STOP");
            }
        });
        let confirmed = async {
            loop {
                let news = self.news.notified();
                if self.others().stopped_since(begun).iter().all(|(_, confirmed)| *confirmed) {
                    return;
                }
                news.await;
            }
        };
        // Who has not confirmed by then is told as that.
        let _ = tokio::time::timeout(FAST_STOP_WAIT, confirmed).await;
    }

    fn of_own(&self, state: &State) -> Option<FleetGripper> {
        let told = told::Told::of(&serde_json::to_vec(state).ok()?)?;
        Some(told.of_gripper(&self.gateway, &state.gripper, Duration::ZERO, false))
    }

    fn take_state(&self, key: &str, state: &[u8]) {
        let Some((gateway, gripper)) = keys::of_gripper(key) else { return };
        if gateway == self.gateway {
            self.others().take_twin(&gateway);
            return;
        }
        if state.len() <= MAX_STATE_BYTES
            && let Some(told) = told::Told::of(state)
        {
            self.others().take_state(gateway, gripper, told);
            self.news.notify_waiters();
        }
    }

    fn take_token(&self, key: &str, is_alive: bool) {
        if let Some(gateway) = keys::of_gateway(key).filter(|gateway| *gateway != self.gateway) {
            tracing::info!(%gateway, is_alive, "another gateway");
            self.others().take_token(gateway, is_alive);
        }
    }

    fn others(&self) -> MutexGuard<'_, Others> {
        self.others.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
