//! Live updates as server-sent events: what happens, from a given event on without a gap, and the newest states.

use std::collections::{HashSet, VecDeque};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State as Shared;
use axum::http::{HeaderMap, Uri};
use axum::response::Sse;
use axum::response::sse::{self, KeepAlive};
use futures_util::stream::{Stream, unfold};
use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use tokio::time::{Interval, MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;
use utoipa::{IntoParams, ToSchema};

use super::Context;
use super::errors::Problem;
use super::parameters::Parameters;
use super::responses::JournalProblem;
use super::values::integer;
use crate::frontend::metrics::Metrics;
use crate::gripper::Now;
use crate::gripper::model::State;
use crate::journal::{Filter, Follow};

/// How often states and telemetry are told at most, unless a client asks for more or less.
const DEFAULT_HZ: u64 = 10;

/// And at most: as often as devices tell.
const MAX_HZ: u64 = 100;

/// How often a stream on which nothing happens says that it is still there, so that proxies keep it.
const KEPT_ALIVE_EVERY: Duration = Duration::from_secs(15);

/// How long a stream rests whose journal can't be read.
const RESTS_FOR: Duration = Duration::from_secs(1);

/// What can be followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Topic {
    /// What happens.
    Events,
    /// The newest states.
    State,
    /// Their measured values alone.
    Telemetry,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "the document's words on what stream takes from the address")]
pub struct StreamQuery {
    /// `events` (default), `state`, `telemetry`, or several of them with commas between.
    #[param(pattern = "^(events|state|telemetry)(,(events|state|telemetry))*$", example = "events,state")]
    topics: Option<String>,
    /// Only of this gripper.
    #[param(max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "left")]
    gripper: Option<String>,
    /// How many states and telemetry a second at most, of each gripper. 10 by default.
    #[param(minimum = 1, maximum = 100, default = 10)]
    max_hz: Option<u64>,
    /// The same as `Last-Event-ID`, for clients that can't set a header: events begin behind this one.
    #[param(minimum = 0, maximum = 999_999_999_999_999_999_i64)]
    after: Option<i64>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "the document's words on what stream takes from the headers")]
pub struct StreamHeaders {
    /// The `seq` of the last event that was seen: events begin behind it, without a gap. Without it they begin now.
    #[param(rename = "Last-Event-ID", nullable = false, pattern = "^([0-9]{1,18})?$")]
    last_event_id: Option<String>,
}

/// One server-sent event.
#[derive(ToSchema)]
#[schema(as = StreamMessage)]
#[allow(dead_code, reason = "the document's words on what stream sends")]
pub struct Message {
    /// `event`, `state` or `telemetry`.
    #[schema(nullable = false)]
    event: Option<String>,
    /// An event's `seq`.
    #[schema(nullable = false)]
    id: Option<String>,
    /// The body, as JSON.
    data: String,
}

/// One client's stream.
struct Subscription {
    events: Option<Follow>,
    grippers: Vec<Told>,
    topics: HashSet<Topic>,
    ticks: Interval,
    metrics: Metrics,
    /// What is to be told, at most a message a topic and gripper.
    ready: VecDeque<sse::Event>,
    closing: CancellationToken,
}

/// One gripper's states, and which of them was told last.
struct Told {
    states: watch::Receiver<Arc<State>>,
    seq: u64,
}

/// Live updates
///
/// Server-sent events: `event` with its `seq` as id, `state`, `telemetry`. Events come without a gap from
/// `Last-Event-ID` on, or from now on; of states and telemetry the newest comes, and what a slow client misses is
/// never queued.
#[utoipa::path(
    get, path = "/stream", operation_id = "stream", tag = "journal",
    params(StreamQuery, StreamHeaders),
    responses((status = 200, description = "The stream", body = Message, content_type = "text/event-stream"), JournalProblem)
)]
pub async fn stream(
    Shared(context): Shared<Arc<Context>>,
    headers: HeaderMap,
    uri: Uri,
) -> Result<Sse<impl Stream<Item = Result<sse::Event, Infallible>>>, Problem> {
    let subscription = Subscription::new(&context, &headers, &uri)?;
    let told = unfold(subscription, |mut subscription| async {
        subscription.next().await.map(|event| (Ok(event), subscription))
    });
    Ok(Sse::new(told).keep_alive(KeepAlive::new().interval(KEPT_ALIVE_EVERY)))
}

impl Subscription {
    fn new(context: &Context, headers: &HeaderMap, uri: &Uri) -> Result<Self, Problem> {
        let given = Parameters::of(uri)?.only(&["topics", "gripper", "max_hz", "after"])?;
        let topics = given.parsed("topics", "events, state, telemetry, with commas between", topics)?;
        let topics = topics.unwrap_or_else(|| HashSet::from([Topic::Events]));
        let name = given.parsed("gripper", "a gripper's name", |text| text.parse().ok())?;
        let grippers: Vec<_> = match &name {
            Some(name) => {
                let unknown = || Problem::not_found("gripper of this name");
                vec![context.fleet.get(name).ok_or_else(unknown)?.states()]
            }
            None => context.fleet.iter().map(crate::gripper::Handle::states).collect(),
        };
        let grippers = grippers.into_iter().map(|states| Told { states, seq: 0 }).collect();
        let max_hz = match given.parsed("max_hz", "a whole number", |text| text.parse::<f64>().ok())? {
            Some(number) => integer("max_hz", number, 1..=MAX_HZ)?,
            None => DEFAULT_HZ,
        };
        let after = given.parsed("after", "the seq of an event: 0 or more", seq)?;
        let after = match headers.get("Last-Event-ID").filter(|id| !id.is_empty()) {
            Some(id) => Some(id.to_str().ok().and_then(seq).ok_or_else(bad_last_event_id)?),
            None => after,
        };
        let filter = Filter { gripper: name, ..Filter::default() };
        let events = topics.contains(&Topic::Events).then(|| context.journal.follow(after, filter));
        let mut ticks = interval(Duration::from_secs(1) / max_hz as u32);
        // A client that was slow gets the newest, and not all that it missed.
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let (metrics, closing) = (context.metrics.clone(), context.closing.clone());
        let mut subscription = Self { events, grippers, topics, ticks, metrics, ready: VecDeque::new(), closing };
        subscription.gather(0, |_| true);
        Ok(subscription)
    }

    /// The next message; none when the gateway ends.
    async fn next(&mut self) -> Option<sse::Event> {
        loop {
            if let Some(event) = self.ready.pop_front() {
                return Some(event);
            }
            let tells_states = self.topics.iter().any(|topic| *topic != Topic::Events);
            tokio::select! {
                biased;
                () = self.closing.cancelled() => return None,
                event = next_event(&mut self.events) => match event {
                    Ok(Some(event)) => return Some(event),
                    Ok(None) => return None,
                    Err(()) => tokio::time::sleep(RESTS_FOR).await,
                },
                due = self.ticks.tick(), if tells_states => {
                    let missed_ticks = due.elapsed().as_nanos() / self.ticks.period().as_nanos();
                    self.gather(missed_ticks as u64, |states| states.has_changed().unwrap_or_default());
                }
            }
        }
    }

    /// Makes messages of the states that are to be told, of which each tick that the client missed would have told one.
    fn gather(&mut self, missed_ticks: u64, is_told: impl Fn(&watch::Receiver<Arc<State>>) -> bool) {
        for Told { states, seq } in &mut self.grippers {
            if !is_told(states) {
                continue;
            }
            let state = states.borrow_and_update().clone();
            let dropped = state.seq.saturating_sub(*seq + 1).min(missed_ticks);
            let told = self.topics.iter().filter_map(|topic| match topic {
                Topic::Events => None,
                Topic::State => sse::Event::default().event("state").json_data(&*state).ok(),
                Topic::Telemetry => {
                    sse::Event::default().event("telemetry").json_data(state.telemetry(Now::read().wall)).ok()
                }
            });
            for message in told {
                self.ready.push_back(message);
                self.metrics.dropped(dropped);
            }
            *seq = state.seq;
        }
    }
}

/// The next event; none after the journal was closed.
async fn next_event(events: &mut Option<Follow>) -> Result<Option<sse::Event>, ()> {
    let Some(events) = events else { return std::future::pending().await };
    match events.next().await {
        Ok(event) => {
            Ok(event.map(|event| sse::Event::default().event("event").id(event.seq.to_string()).data(&*event.body)))
        }
        Err(error) => {
            tracing::warn!(%error, "a stream's events can't be read");
            Err(())
        }
    }
}

/// Each once, however often it is named.
fn topics(text: &str) -> Option<HashSet<Topic>> {
    text.split(',').map(|topic| serde_json::from_value(topic.into()).ok()).collect()
}

fn seq(text: &str) -> Option<i64> {
    // Of more digits there is none.
    let digits = text.len() <= 18 && text.bytes().all(|byte| byte.is_ascii_digit());
    text.parse().ok().filter(|_| digits)
}

fn bad_last_event_id() -> Problem {
    Problem::malformed("Last-Event-ID", "Last-Event-ID must be the seq of an event: 0 or more")
}

#[cfg(test)]
mod tests {
    use prometheus::TextEncoder;

    use super::*;
    use crate::gripper::fake::{self, Script};
    use crate::gripper::model::{Client, Door, FastStopId, Reason};

    #[tokio::test(start_paused = true)]
    async fn states_that_a_slow_client_misses_are_counted_and_those_beyond_its_rate_are_not() {
        let (handle, _seen) = fake::gripper("left", Script::default());
        let context = Context::of([handle.clone()]);
        let uri = Uri::from_static("/stream?topics=state,telemetry&max_hz=10");
        let mut subscription = Subscription::new(&context, &HeaderMap::new(), &uri).unwrap();
        // Between the changes no time passes; each is told as a state and as telemetry.
        for (changes, later_ms, expected) in [(0, 0, 0), (3, 0, 0), (3, 350, 4), (1, 350, 4), (10, 100, 4)] {
            for _ in 0..changes {
                let client = Client { subject: "test".into(), door: Door::Http };
                handle.fast_stop(FastStopId::generate(), client, Reason::truncated("")).await;
            }
            tokio::time::advance(Duration::from_millis(later_ms)).await;
            for _ in 0..2 {
                assert!(subscription.next().await.is_some());
            }
            let text = TextEncoder::new().encode_to_string(&context.registry.gather()).unwrap();
            let line = format!("wsg_updates_dropped_total{{door=\"http\"}} {expected}");
            assert!(text.lines().any(|other| other == line), "no {line} after {changes} changes in\n{text}");
        }
    }
}
