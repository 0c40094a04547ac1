//! Live updates as server-sent events: events without a gap from a given one on, the newest states, and frames.

use std::collections::{BTreeSet, VecDeque};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State as Shared;
use axum::http::{Extensions, HeaderMap, HeaderName, HeaderValue, Uri};
use axum::response::sse::{self, KeepAlive};
use axum::response::{IntoResponse, Sse};
use futures_util::stream::unfold;
use tokio::time::{Interval, MissedTickBehavior};
use tokio_util::sync::CancellationToken;
use utoipa::IntoParams;

use super::tickets::TICKET;
use crate::access::{Access, Visitor};
use crate::connections::admission::{Claim, Class, ConnectionPermit};
use crate::connections::metrics::InterfaceMetrics;
use crate::events::{DEFAULT_HZ, Gap, MAX_HZ, Notification, Pace, Subscription, Topic};
use crate::interfaces::http::context::HttpContext;
use crate::interfaces::http::documents::paths::responses::JournalProblem;
use crate::interfaces::http::requests::visitor::Identified;
use crate::interfaces::http::server::runtime_mover::RuntimeMover;
use crate::journal::{EventStream, Filter, StreamItem};
use crate::model::Name;
use crate::operations::parameters::values::integer;
use crate::operations::{Code, Problem, QueryString, words};

/// Keeps nginx from collecting the stream's messages before it passes them on.
const UNBUFFERED: (HeaderName, HeaderValue) =
    (HeaderName::from_static("x-accel-buffering"), HeaderValue::from_static("no"));

/// Interval of keep-alive comments on an idle stream, so that proxies keep the connection open.
const KEPT_ALIVE_EVERY: Duration = Duration::from_secs(15);

/// Interval of the checks that the client's credential is still valid.
const CHECKED_EVERY: Duration = Duration::from_secs(1);

const READ_RETRY_PAUSE: Duration = Duration::from_secs(1);

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only describes the parameters that `Stream::new` reads")]
pub struct StreamQuery {
    /// `events` (default), `grips`, `state`, `telemetry`, `frames`, `exchanges`, `fleet`, `alarms`, or several of them separated by commas.
    #[param(
        pattern = "^(events|grips|state|telemetry|frames|exchanges|fleet|alarms)(,(events|grips|state|telemetry|frames|exchanges|fleet|alarms))*$",
        example = "events,state"
    )]
    topics: Option<String>,
    /// Only updates of this gripper.
    #[param(max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "left")]
    gripper: Option<String>,
    /// Maximum rate of states and telemetry for each gripper, per second. 10 by default.
    #[param(minimum = 1, maximum = 100, default = 10)]
    max_hz: Option<u64>,
    /// Same as `Last-Event-ID`, for clients that can't set a header: events start after this one.
    #[param(minimum = 0, maximum = 999_999_999_999_999_999_i64)]
    after: Option<i64>,
    /// Ticket in place of a credential, for web pages of other origins.
    #[param(max_length = 64, pattern = "^[A-Za-z0-9_-]*$")]
    ticket: Option<String>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "only describes the headers that `Stream::new` reads")]
pub struct StreamHeaders {
    /// The `seq` of the last event that the client has seen. Events start after it, and a `gap` gives the number of
    /// events that are no longer stored. Without this header, events start now.
    #[param(rename = "Last-Event-ID", nullable = false, pattern = "^([0-9]{1,18})?$")]
    last_event_id: Option<String>,
}

struct Stream {
    events: Option<EventStream>,
    updates: Subscription,
    pace: Pace,
    metrics: InterfaceMetrics,
    /// Messages to send next, at most one for each topic and gripper.
    ready: VecDeque<Notification>,
    closing: CancellationToken,
    /// The client, whose credential can end.
    client: (Arc<Access>, Visitor),
    checks: Interval,
    _claim: Option<Claim>,
}

/// Stream live updates
///
/// Sends server-sent events: `event` with its `seq` as id, `grip`, `state`, `telemetry`, `frame`, `damage`, `fleet`,
/// `alarms` and `gap`. Their data is JSON, with the schemas of the AsyncAPI document.
///
/// Events continue without a gap after `Last-Event-ID`; without that header they start now. A `gap` gives the number of
/// events after that id that are no longer stored, for all grippers together. If the journal was replaced and has not
/// reached that id yet, events start from the journal's first.
///
/// A `grip` is a grip record, sent once it is stored. It is sent again with `part_lost_at` if its part is lost. Grip
/// records always start now, regardless of `Last-Event-ID`.
///
/// For states and telemetry only the newest value is sent: values that a slow client misses are not queued. Frames are
/// sent in order, with a `damage` where bytes from the device were not a valid frame. A `gap` gives the number of
/// `frame` and `damage` messages that a slow client missed.
#[utoipa::path(
    get, path = "/stream", operation_id = "stream", tag = "journal",
    params(StreamQuery, StreamHeaders),
    responses((status = 200, description = "The stream", body = String, content_type = "text/event-stream"), JournalProblem)
)]
pub async fn stream(
    Shared(context): Shared<Arc<HttpContext>>,
    headers: HeaderMap,
    uri: Uri,
    extensions: Extensions,
) -> Result<impl IntoResponse, Problem> {
    let visitor = Identified::client_of(&context.gateway.access, &extensions).visitor;
    let stream = Stream::new(&context, visitor, &headers, &uri)?;
    let permit = extensions.get::<Arc<ConnectionPermit>>();
    let claim = permit.map(|permit| permit.claim(Class::Streaming).ok_or_else(too_many)).transpose()?;
    let stream = Stream { _claim: claim, ..stream };
    // Sending to a thousand observers must not delay requests.
    if let Some(mover) = extensions.get::<RuntimeMover>() {
        mover.move_to(&context.runtimes.observers);
    }
    let messages =
        unfold(stream, |mut stream| async { stream.next().await.map(|event| (Ok::<_, Infallible>(event), stream)) });
    Ok(([UNBUFFERED], Sse::new(messages).keep_alive(KeepAlive::new().interval(KEPT_ALIVE_EVERY))))
}

impl Stream {
    fn new(context: &HttpContext, visitor: Visitor, headers: &HeaderMap, uri: &Uri) -> Result<Self, Problem> {
        let given = QueryString::of(uri).only(&["topics", "gripper", "max_hz", "after", TICKET])?;
        let mut topics = given
            .parsed("topics", &format!("{}, separated by commas", words::<Topic>()), topics)?
            .unwrap_or_else(|| BTreeSet::from([Topic::Events]));
        let name: Option<Name> = given.parsed("gripper", "a gripper's name", |text| text.parse().ok())?;
        if let Some(name) = &name {
            context.gateway.grippers.get(name).ok_or_else(|| context.gateway.no_gripper(name.as_str(), true))?;
        }
        let max_hz = match given.parsed("max_hz", "a whole number", |text| text.parse::<f64>().ok())? {
            Some(number) => integer("max_hz", number, 1..=MAX_HZ)?,
            None => DEFAULT_HZ,
        };
        let after = given.parsed("after", "the seq of an event: 0 or more", seq)?;
        let after = match headers.get("Last-Event-ID").filter(|id| !id.is_empty()) {
            Some(id) => Some(id.to_str().ok().and_then(seq).ok_or_else(bad_last_event_id)?),
            None => after,
        };
        let only = name.iter().cloned().collect();
        let filter = Filter { gripper: name.clone(), ..Filter::default() };
        // Events come from the journal itself, so they have no gap.
        let events = topics.remove(&Topic::Events).then(|| context.gateway.journal.follow(after, filter));
        let mut updates = context.gateway.updates.subscribe(name.as_ref().map(|_| &only), topics.iter().copied());
        let mut ready = VecDeque::new();
        for state in updates.snapshot() {
            if topics.contains(&Topic::State) {
                ready.extend(Notification::new("state", &*state));
            }
            if topics.contains(&Topic::Telemetry) {
                ready.extend(Notification::telemetry(&state));
            }
        }
        let metrics = context.metrics.clone();
        let closing = context.closing.clone();
        let client = (context.gateway.access.clone(), visitor);
        let pace = Pace::new(max_hz as u32);
        let mut checks = tokio::time::interval(CHECKED_EVERY);
        checks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Ok(Self { events, updates, pace, metrics, ready, closing, client, checks, _claim: None })
    }

    /// Returns the next message, or `None` when the gateway shuts down or the client's credential ends.
    async fn next(&mut self) -> Option<sse::Event> {
        loop {
            if let Some(notification) = self.ready.pop_front() {
                return Some(message(&notification));
            }
            tokio::select! {
                biased;
                () = self.closing.cancelled() => return None,
                _ = self.checks.tick() => {
                    let (access, visitor) = &self.client;
                    if !visitor.may_read(access) {
                        return None;
                    }
                }
                event = next_event(&mut self.events) => match event {
                    Ok(Some(event)) => return Some(event),
                    Ok(None) => return None,
                    Err(()) => tokio::time::sleep(READ_RETRY_PAUSE).await,
                },
                frame = self.updates.next() => self.ready.push_back(frame),
                missed = self.pace.next(), if self.updates.has_states() => {
                    let (newest, dropped) = self.updates.newest(missed);
                    self.ready.extend(newest);
                    self.metrics.dropped(dropped);
                }
            }
        }
    }
}

/// Problem of a WebSocket or stream beyond the limit.
pub fn too_many() -> Problem {
    Problem::new(Code::Overloaded, "too many WebSockets and streams are open: close some, or poll the state")
}

fn message(notification: &Notification) -> sse::Event {
    sse::Event::default().event(notification.method()).data(notification.body())
}

/// Returns the next event or the gap before it, or `None` after the journal was closed.
async fn next_event(events: &mut Option<EventStream>) -> Result<Option<sse::Event>, ()> {
    let Some(events) = events else { return std::future::pending().await };
    match events.next().await {
        Ok(None) => Ok(None),
        Ok(Some(StreamItem::Event(event))) => {
            Ok(Some(sse::Event::default().event("event").id(event.seq.to_string()).data(&*event.body)))
        }
        Ok(Some(StreamItem::Removed { after, missed })) => {
            let gap = Notification::new("gap", &Gap::of_events(after, missed.unsigned_abs())).ok_or(())?;
            Ok(Some(message(&gap).id((after + missed).to_string())))
        }
        Err(error) => {
            tracing::warn!(%error, "stream events could not be read; retrying");
            Err(())
        }
    }
}

/// Parses topics, without duplicates.
fn topics(text: &str) -> Option<BTreeSet<Topic>> {
    text.split(',').map(|topic| serde_json::from_value(topic.into()).ok()).collect()
}

fn seq(text: &str) -> Option<i64> {
    // No event has a longer number.
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
    use crate::access::{ClientOrigin, Credential};
    use crate::gripper::fake::{self, FakeScript};
    use crate::model::{Client, Door, FastStopId, Reason};

    #[tokio::test(start_paused = true)]
    async fn missed_states_are_counted_unless_rate_limited() {
        let (handle, _seen) = fake::gripper("left", FakeScript::default());
        let context = HttpContext::of([handle.clone()]);
        let uri = Uri::from_static("/stream?topics=state,telemetry&max_hz=10");
        let nobody = Visitor { credential: Credential::None, origin: ClientOrigin::default() };
        let mut stream = Stream::new(&context, nobody, &HeaderMap::new(), &uri).unwrap();
        // No time passes between the changes; each is sent as a state and as telemetry.
        for (changes, later_ms, expected) in [(0, 0, 0), (3, 0, 0), (3, 350, 4), (1, 350, 4), (10, 100, 4)] {
            for _ in 0..changes {
                let client = Client::new("test", Door::Http);
                handle.fast_stop(FastStopId::generate(), client, Reason::truncated("")).await;
            }
            tokio::time::advance(Duration::from_millis(later_ms)).await;
            for _ in 0..2 {
                assert!(stream.next().await.is_some());
            }
            let text = TextEncoder::new().encode_to_string(&context.registry.gather()).unwrap();
            let line = format!("wsg_updates_dropped_total{{door=\"http\"}} {expected}");
            assert!(text.lines().any(|other| other == line), "no {line} after {changes} changes in\n{text}");
        }
    }
}
