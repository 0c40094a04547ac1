//! Publications: the newest states and telemetry, and every event.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{MissedTickBehavior, interval};
use zenoh::Wait as _;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};

use crate::events::{Notification, Pace, Topic};
use crate::fleet::keys::ZenohKeys;
use crate::gripper::Handle;
use crate::interfaces::Context;
use crate::journal::{Filter, Stored, StreamItem};
use crate::model::{Link, State};

/// Interval at which an unchanged state is repeated. Subscribers can detect a lost gateway by its silence, and a
/// dropped state is replaced.
const REPEATED_EVERY: Duration = Duration::from_millis(500);

const READ_RETRY_PAUSE: Duration = Duration::from_secs(1);

pub struct Publications {
    session: zenoh::Session,
    handle: Handle,
    alive_key: String,
    state: Publisher<'static>,
    telemetry: Publisher<'static>,
    alive: Option<LivelinessToken>,
    /// The last published state.
    published: Option<Arc<State>>,
}

impl Publications {
    pub async fn declare(session: &zenoh::Session, keys: &ZenohKeys, handle: &Handle) -> zenoh::Result<Self> {
        Ok(Self {
            session: session.clone(),
            handle: handle.clone(),
            alive_key: keys.gripper(handle.name(), "alive"),
            state: declare_publisher(session, keys.gripper(handle.name(), "state"), Priority::Data).await?,
            telemetry: declare_publisher(session, keys.gripper(handle.name(), "telemetry"), Priority::DataLow).await?,
            alive: None,
            published: None,
        })
    }

    /// Publishes states and telemetry at `max_hz` at most, until the gateway closes.
    pub async fn run(mut self, context: Context, max_hz: u32) {
        let only = BTreeSet::from([self.handle.name().clone()]);
        let mut updates = context.gateway.updates.subscribe(Some(&only), [Topic::Telemetry]);
        let mut pace = Pace::new(max_hz);
        let mut unchanged = interval(REPEATED_EVERY);
        unchanged.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                () = context.closing.cancelled() => return,
                missed = pace.next() => {
                    let (newest, dropped) = updates.newest(missed);
                    context.metrics.dropped(dropped);
                    for telemetry in newest {
                        publish(&self.telemetry, &telemetry);
                    }
                    if let Some(state) = self.news() {
                        publish(&self.state, &state);
                        unchanged.reset();
                    }
                    self.keep_token();
                }
                _ = unchanged.tick() => {
                    if let Some(state) = Notification::new("state", &*self.handle.state()) {
                        publish(&self.state, &state);
                    }
                }
            }
        }
    }

    /// Returns the state if more than its age has changed, since each published state goes to all gateways of the
    /// fleet.
    fn news(&mut self) -> Option<Notification> {
        let state = self.handle.state();
        if self.published.as_ref().is_some_and(|published| published.is_like(&state)) {
            return None;
        }
        self.published = Some(state.clone());
        Notification::new("state", &*state)
    }

    /// Keeps the gripper's liveliness token declared while its link is up.
    fn keep_token(&mut self) {
        let is_up = self.handle.state().link == Link::Connected;
        match (is_up, &self.alive) {
            (true, None) => {
                let token = self.session.liveliness().declare_token(self.alive_key.clone()).wait();
                self.alive =
                    token.inspect_err(|error| tracing::warn!(%error, "liveliness token could not be declared")).ok();
            }
            // Dropping the token withdraws it.
            (false, Some(_)) => self.alive = None,
            _ => {}
        }
    }
}

/// Declares a publisher of JSON, which drops what a slow subscriber does not take.
async fn declare_publisher(
    session: &zenoh::Session,
    key: String,
    priority: Priority,
) -> zenoh::Result<Publisher<'static>> {
    let publisher = session.declare_publisher(key).encoding(Encoding::APPLICATION_JSON);
    publisher.priority(priority).congestion_control(CongestionControl::Drop).await
}

fn publish(publisher: &Publisher<'_>, notification: &Notification) {
    if let Err(error) = publisher.put(notification.body()).wait() {
        tracing::debug!(%error, "state not published");
    }
}

/// Publishes all events from now on, in order and once they are durable, until the gateway closes.
pub async fn publish_events(session: zenoh::Session, keys: ZenohKeys, context: Context) {
    let mut events = context.gateway.journal.follow(None, Filter::default());
    loop {
        let event = tokio::select! {
            biased;
            () = context.closing.cancelled() => return,
            event = events.next() => event,
        };
        match event {
            Ok(Some(StreamItem::Event(event))) => publish_event(&session, &keys, event).await,
            Ok(Some(StreamItem::Removed { missed, .. })) => {
                tracing::warn!(missed, "events lost: removed from the journal before Zenoh published them");
            }
            Ok(None) => return,
            Err(error) => {
                tracing::warn!(%error, "Zenoh events could not be read; retrying");
                tokio::time::sleep(READ_RETRY_PAUSE).await;
            }
        }
    }
}

/// Publishes an event. No event is dropped for a slow client. A client that reads nothing is disconnected after a
/// while; the blocking thread waits for that.
async fn publish_event(session: &zenoh::Session, keys: &ZenohKeys, event: Arc<Stored>) {
    let key = event.gripper.as_ref().map_or_else(|| keys.own("event"), |gripper| keys.gripper(gripper, "event"));
    let session = session.clone();
    let published = tokio::task::spawn_blocking(move || {
        let put = session.put(key, &*event.body).encoding(Encoding::APPLICATION_JSON);
        put.priority(Priority::DataHigh).congestion_control(CongestionControl::Block).wait()
    });
    if let Ok(Err(error)) = published.await {
        tracing::debug!(%error, "event not published");
    }
}
