//! Publications: states and telemetry, of which the newest counts, and events, none of which is left out.

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
use crate::fleet::keys::Keys;
use crate::gripper::Handle;
use crate::gripper::model::{Link, State};
use crate::interfaces::Context;
use crate::journal::{Filter, Stored, StreamItem};

/// How often a state is told that has not changed: who counts on it sees by its silence that the gateway is gone, and
/// one that was dropped on its way is made up for.
const TOLD_EVERY: Duration = Duration::from_millis(500);

/// How long events rest whose journal can't be read.
const READ_RETRY_PAUSE: Duration = Duration::from_secs(1);

/// What one gripper publishes.
pub struct Publications {
    session: zenoh::Session,
    handle: Handle,
    alive_key: String,
    state: Publisher<'static>,
    telemetry: Publisher<'static>,
    alive: Option<LivelinessToken>,
    /// What was told last, without what changes all the time.
    told: Option<State>,
}

impl Publications {
    /// Of this gripper.
    pub async fn declare(session: &zenoh::Session, keys: &Keys, handle: &Handle) -> zenoh::Result<Self> {
        let publisher = |what, priority| {
            let publisher = session.declare_publisher(keys.gripper(handle.name(), what));
            publisher
                .encoding(Encoding::APPLICATION_JSON)
                .priority(priority)
                .congestion_control(CongestionControl::Drop)
        };
        Ok(Self {
            session: session.clone(),
            handle: handle.clone(),
            alive_key: keys.gripper(handle.name(), "alive"),
            state: publisher("state", Priority::Data).await?,
            telemetry: publisher("telemetry", Priority::DataLow).await?,
            alive: None,
            told: None,
        })
    }

    /// Tells states and telemetry, so often a second at most, until the gateway closes.
    pub async fn tell(mut self, context: Context, max_hz: u32) {
        let only = BTreeSet::from([self.handle.name().clone()]);
        let mut updates = context.gateway.updates.subscribe(Some(&only), [Topic::Telemetry]);
        let mut pace = Pace::new(max_hz);
        let mut unchanged = interval(TOLD_EVERY);
        unchanged.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                () = context.closing.cancelled() => return,
                missed = pace.next() => {
                    let (told, dropped) = updates.newest(missed);
                    context.metrics.dropped(dropped);
                    for told in told {
                        publish(&self.telemetry, &told);
                    }
                    if let Some(told) = self.news() {
                        publish(&self.state, &told);
                        unchanged.reset();
                    }
                    self.keep_token();
                }
                _ = unchanged.tick() => {
                    if let Some(told) = Notification::new("state", &*self.handle.state()) {
                        publish(&self.state, &told);
                    }
                }
            }
        }
    }

    /// The state, where it says more than that the device is still there: all gateways of a fleet are told each that does.
    fn news(&mut self) -> Option<Notification> {
        let state = self.handle.state();
        let lasting = State { seq: 0, updated_at: None, ..State::clone(&state) };
        if self.told.as_ref() == Some(&lasting) {
            return None;
        }
        self.told = Some(lasting);
        Notification::new("state", &*state)
    }

    /// Declares the gripper alive while its link is up.
    fn keep_token(&mut self) {
        let is_up = self.handle.state().link == Link::Connected;
        match (is_up, &self.alive) {
            (true, None) => {
                let token = self.session.liveliness().declare_token(self.alive_key.clone()).wait();
                self.alive = token.inspect_err(|error| tracing::warn!(%error, "no liveliness token")).ok();
            }
            // Its end is its withdrawal.
            (false, Some(_)) => self.alive = None,
            _ => {}
        }
    }
}

fn publish(publisher: &Publisher<'_>, told: &Notification) {
    if let Err(error) = publisher.put(told.body()).wait() {
        tracing::debug!(%error, "a state is not published");
    }
}

/// Publishes all events from now on, in order, once they are durable, until the gateway closes.
pub async fn tell_events(session: zenoh::Session, keys: Keys, context: Context) {
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
                tracing::warn!(missed, "events were too old before Zenoh had taken them");
            }
            Ok(None) => return,
            Err(error) => {
                tracing::warn!(%error, "Zenoh's events can't be read");
                tokio::time::sleep(READ_RETRY_PAUSE).await;
            }
        }
    }
}

/// None is dropped for a slow client; one that takes nothing at all is disconnected after a while, which is waited for
/// where nobody else waits.
async fn publish_event(session: &zenoh::Session, keys: &Keys, event: Arc<Stored>) {
    let key = event.gripper.as_ref().map_or_else(|| keys.own("event"), |gripper| keys.gripper(gripper, "event"));
    let session = session.clone();
    let published = tokio::task::spawn_blocking(move || {
        let put = session.put(key, &*event.body).encoding(Encoding::APPLICATION_JSON);
        put.priority(Priority::DataHigh).congestion_control(CongestionControl::Block).wait()
    });
    if let Ok(Err(error)) = published.await {
        tracing::debug!(%error, "an event is not published");
    }
}
