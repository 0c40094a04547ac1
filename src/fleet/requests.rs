//! Requests to other gateways: run an operation of the gateway or of one of its grippers, and return the answer
//! unchanged.

use std::convert::Infallible;
use std::fmt;
use std::future::pending;
use std::time::Duration;

use futures_util::stream::{FuturesUnordered, StreamExt as _};
use serde::Deserialize;
use serde_json::value::RawValue;
use serde_json::{Value, json};
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use tokio::time::{Instant, sleep, sleep_until, timeout};
use zenoh::Wait as _;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::qos::Priority;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::sample::Locality;

use super::Peers;
use super::keys::{self, MAX_CLIENT_BYTES, ZenohKeys};
use super::name_conflicts::has_token;
use super::reply_bounds::{CollectedRoom, MAX_REPLY_BYTES, MAX_WAITING, ReplyFilter, WaitingReply};
use crate::gripper::Now;
use crate::model::lease::MIN_TTL;
use crate::model::{Client, Name, Text, Urgency};

/// Time that an answer may spend on the network, in addition to the operation's own time.
const ON_ITS_WAY: Duration = Duration::from_secs(5);

/// Time that a request waits for its turn to collect reads of all gateways.
const COLLECTS_WITHIN: Duration = Duration::from_secs(10);

/// Uses of a kept lease per time to live: two can get lost, and the third can be late.
const USES_A_TTL: u32 = 4;

/// Maximum number of unanswered uses of a lease. Each can occupy a thread for as long as Zenoh has no room for the
/// message.
const MAX_USES_UNDER_WAY: usize = 2;

/// Shortest time allowed for the answer to a use.
const MIN_ANSWERED_WITHIN: Duration = Duration::from_millis(250);

/// Number of attempts to find the token of a replying session, and the interval between them.
const PROOFS: u32 = 10;
const PROVES_EVERY: Duration = Duration::from_millis(100);

/// Maximum number of replies whose sessions are checked concurrently.
const MAX_PROOFS: usize = 16;

/// Prefix of the methods that manage a lease themselves. No lease is kept for them.
const LEASE_METHODS: &str = "lease.";

/// Field with a lease token.
const LEASE: &str = "lease";

/// HTTP status that refuses the token of an ended lease.
const CONFLICT: u16 = 409;

/// Selector parameter with the client's token.
pub const TOKEN: &str = "token";

/// Keys at which a gateway answers reads of its own: its lists of records, and its readiness.
pub const EVENTS: &str = "events";
pub const GRIPS: &str = "grips";
pub const READINESS: &str = "readiness";

/// A request to another gateway. Debug output hides what is sent along, which can be secret.
#[derive(Clone)]
pub struct PeerRequest {
    pub gateway: Name,
    /// The gripper; `None` for an operation of the gateway as a whole.
    pub gripper: Option<Name>,
    /// Method name of the operation.
    pub method: &'static str,
    pub params: Value,
    /// Time that the operation may take there; `None` leaves it to the other gateway.
    pub wait: Option<Duration>,
    /// Values sent along with the parameters: `lease`, `request_id`, `token`.
    pub aside: Vec<(&'static str, String)>,
    /// The client of this gateway that makes the request.
    pub client: Client,
    /// Precedence over other requests.
    pub urgency: Urgency,
}

impl fmt::Debug for PeerRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { gateway, gripper, method, .. } = self;
        let gripper = gripper.as_ref().map_or("", Name::as_str);
        f.debug_struct("PeerRequest").field("to", &format_args!("{gateway}/{gripper}/{method}")).finish_non_exhaustive()
    }
}

/// The priority of a request on the network.
fn priority(urgency: Urgency) -> Priority {
    match urgency {
        Urgency::FastStop => Priority::RealTime,
        Urgency::Stop | Urgency::Lease => Priority::InteractiveHigh,
        Urgency::None => Priority::DataHigh,
    }
}

/// The answer: a body, or a problem with its status.
pub type PeerResponse = Result<Box<RawValue>, (u16, Box<RawValue>)>;

/// Reason for a missing answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoAnswer {
    /// No gateway has this name.
    Unknown,
    /// The gateway is gone; nothing was sent.
    Gone,
    /// Too many requests are under way; nothing was sent.
    TooMany,
    /// There was no room for the answer, because other large ones took it.
    TooLarge,
    /// No answer came; the result is unknown.
    None,
}

impl Peers {
    /// Sends a request to a gateway, and waits for its answer. Keeps the named lease during the wait, and no longer.
    ///
    /// # Errors
    /// [`NoAnswer`], which says whether anything was sent.
    pub async fn ask(&self, ask: PeerRequest) -> Result<PeerResponse, NoAnswer> {
        match self.others().has_lost(&ask.gateway, ask.gripper.as_ref(), Now::read().instant) {
            None => return Err(NoAnswer::Unknown),
            // A motion must not wait for the gateway to come back. A stop is worth the attempt, and so is a lease.
            Some(true) if ask.urgency == Urgency::None => return Err(NoAnswer::Gone),
            Some(_) => {}
        }
        let places = match ask.urgency {
            Urgency::FastStop => None,
            Urgency::Lease => Some(&self.leases),
            Urgency::Stop => Some(&self.stops),
            Urgency::None => Some(&self.asks),
        };
        let place = places.map(|places| places.clone().try_acquire_owned()).transpose();
        let _place = place.map_err(|_| NoAnswer::TooMany)?;
        let renewal = ask.renewal();
        let kept = async {
            match renewal {
                Some(renewal) => keep_lease(|| self.send(renewal.clone())).await,
                None => pending().await,
            }
        };
        tokio::select! {
            answer = self.send(ask) => answer,
            never = kept => match never {},
        }
    }

    /// Returns the reply if its session is known as `gateway`, else `None`. After an outage, the reply can come before
    /// the session's token, so the check is repeated up to [`PROOFS`] times.
    async fn of_owner(&self, gateway: &Name, waiting: WaitingReply) -> Option<WaitingReply> {
        let session = self.session.get()?;
        let replier = waiting.reply.replier_id()?.zid().to_string();
        for _ in 0..PROOFS {
            // In a single condition, the lock would be held across the await.
            let is_known = self.others().is_instance(gateway, &replier);
            if is_known || has_token(session, &ZenohKeys::of(gateway), &replier).await {
                return Some(waiting);
            }
            sleep(PROVES_EVERY).await;
        }
        None
    }

    /// Waits for a turn to collect reads of all gateways with [`Peers::read`]. The turn lasts until the value is dropped.
    pub async fn collection(&self) -> Option<OwnedSemaphorePermit> {
        timeout(COLLECTS_WITHIN, self.collections.clone().acquire_owned()).await.ok()?.ok()
    }

    /// Reads something of another gateway as a whole. `query` has the filters. The response comes with its room, which has
    /// to be kept as long as the response.
    ///
    /// # Errors
    /// [`NoAnswer`], if the gateway does not answer.
    pub async fn read(
        &self,
        gateway: &Name,
        what: &'static str,
        query: String,
    ) -> Result<(PeerResponse, CollectedRoom), NoAnswer> {
        let _place = self.asks.clone().try_acquire_owned().map_err(|_| NoAnswer::TooMany)?;
        let response = self.get(gateway, ZenohKeys::of(gateway).own(what), query, ON_ITS_WAY, Urgency::None).await?;
        let (Ok(text) | Err((_, text))) = &response;
        let room = self.reply_room.collected(text.get().len()).ok_or(NoAnswer::TooLarge)?;
        Ok((response, room))
    }

    async fn send(&self, ask: PeerRequest) -> Result<PeerResponse, NoAnswer> {
        let key = ZenohKeys::of(&ask.gateway).command(ask.gripper.as_ref(), ask.method);
        let subject = ("client", forwarded_name(&self.gateway, &ask.client));
        let wait_ms = ask.wait.map(|wait| ("wait_ms", wait.as_millis().to_string()));
        let parameters = [subject].into_iter().chain(wait_ms).chain(ask.aside);
        let parameters: Vec<_> = parameters.map(|(key, value)| format!("{key}={}", keys::encoded(&value))).collect();
        let within = ask.wait.unwrap_or_default() + ON_ITS_WAY;
        let selector = format!("{key}?{}", parameters.join(";"));
        self.get(&ask.gateway, selector, ask.params.to_string(), within, ask.urgency).await
    }

    /// Queries another gateway, and returns its reply.
    async fn get(
        &self,
        gateway: &Name,
        selector: String,
        payload: String,
        within: Duration,
        urgency: Urgency,
    ) -> Result<PeerResponse, NoAnswer> {
        let session = self.session.get().cloned().ok_or(NoAnswer::Unknown)?;
        // The send can block, so it gets a thread on which nothing else waits.
        let filter = ReplyFilter::new(&self.reply_room);
        let (waiting, mut replies) = mpsc::channel(MAX_WAITING);
        let sent = tokio::task::spawn_blocking(move || {
            let get = session.get(selector).payload(payload).timeout(within);
            let get = get.encoding(Encoding::APPLICATION_JSON).allowed_destination(Locality::Remote);
            // Without consolidation, a stranger's reply cannot replace another one with the same key.
            let get = get.target(QueryTarget::All).consolidation(ConsolidationMode::None);
            let get = get.express(urgency == Urgency::FastStop).priority(priority(urgency));
            let get = get.callback(move |reply| {
                // Zenoh's own thread must not wait. Beyond the room for them, replies are dropped.
                if let Some(reply) = filter.take(reply) {
                    let _ = waiting.try_send(reply);
                }
            });
            get.wait()
        });
        sent.await.ok().and_then(Result::ok).ok_or(NoAnswer::None)?;
        let mut proofs = FuturesUnordered::new();
        let mut refused = None;
        loop {
            let reply = tokio::select! {
                Some(reply) = proofs.next() => reply,
                Some(reply) = replies.recv(), if proofs.len() < MAX_PROOFS => {
                    proofs.push(self.of_owner(gateway, reply));
                    continue;
                }
                else => break,
            };
            // If several gateways with that name answer, the one that carried out the request counts.
            match reply.as_ref().and_then(|waiting| parse_reply(&waiting.reply)) {
                Some(Ok(answer)) => return Ok(Ok(answer)),
                other => refused = other.or(refused),
            }
        }
        refused.ok_or(NoAnswer::None)
    }
}

/// Returns the name under which another gateway knows a client of this one. Only the name of a Zenoh client can be too
/// long, and is cut.
fn forwarded_name(gateway: &Name, client: &Client) -> String {
    Text::<MAX_CLIENT_BYTES>::truncated(&format!("{gateway}/{}", client.subject)).as_str().to_owned()
}

/// Uses a lease often enough to keep it, for as long as this is polled. The owning gateway cannot see whether the
/// client is still connected here. Each use is sent on time, whatever happened to the one before.
async fn keep_lease<Sent: Future<Output = Result<PeerResponse, NoAnswer>>>(send_use: impl Fn() -> Sent) -> Infallible {
    #[derive(Deserialize)]
    struct Renewed {
        ttl_ms: u64,
    }
    // Applies until the lease's time to live is known.
    let mut every = MIN_TTL / USES_A_TTL;
    let mut next = Instant::now() + every;
    let mut under_way = FuturesUnordered::new();
    loop {
        tokio::select! {
            () = sleep_until(next), if under_way.len() < MAX_USES_UNDER_WAY => {
                let within = (every * MAX_USES_UNDER_WAY as u32).max(MIN_ANSWERED_WITHIN);
                under_way.push(timeout(within, send_use()));
                next = Instant::now() + every;
            }
            Some(answer) = under_way.next() => match answer {
                Ok(Ok(Ok(lease))) => {
                    let ttl = serde_json::from_str(lease.get()).map(|Renewed { ttl_ms }| Duration::from_millis(ttl_ms));
                    let known = ttl.map_or(every, |ttl| ttl.max(MIN_TTL) / USES_A_TTL);
                    next = next - every + known;
                    every = known;
                }
                // The lease has ended.
                Ok(Ok(Err((CONFLICT, _)))) => return pending().await,
                _ => {}
            }
        }
    }
}

impl PeerRequest {
    /// Returns the request that keeps the named lease. `None` if no lease is named, or if this is a FAST STOP or
    /// manages a lease itself.
    fn renewal(&self) -> Option<Self> {
        if self.urgency == Urgency::FastStop || self.method.starts_with(LEASE_METHODS) {
            return None;
        }
        let aside = self.aside.iter().find(|(name, _)| *name == LEASE).map(|(_, lease)| lease.as_str());
        let lease = aside.or_else(|| self.params.get(LEASE)?.as_str()).filter(|lease| !lease.is_empty())?;
        Some(Self {
            gateway: self.gateway.clone(),
            gripper: self.gripper.clone(),
            method: "lease.renew",
            params: json!({LEASE: lease}),
            wait: None,
            aside: self.aside.iter().filter(|(name, _)| *name == TOKEN).cloned().collect(),
            client: self.client.clone(),
            urgency: Urgency::Lease,
        })
    }
}

/// Parses a gateway's reply. Returns `None` for Zenoh's own replies, which report a time-out.
fn parse_reply(reply: &Reply) -> Option<PeerResponse> {
    #[derive(Deserialize)]
    struct Status {
        status: u16,
    }
    match reply.result() {
        Ok(sample) => Some(Ok(bounded_json(sample.payload())?)),
        Err(error) => {
            let problem = bounded_json(error.payload())?;
            let Status { status } = serde_json::from_str(problem.get()).ok()?;
            Some(Err((status, problem)))
        }
    }
}

/// Returns the JSON in a payload, unless it is too large.
fn bounded_json(payload: &ZBytes) -> Option<Box<RawValue>> {
    if payload.len() > MAX_REPLY_BYTES {
        return None;
    }
    serde_json::from_slice(&payload.to_bytes()).ok()
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use futures_util::future::{FutureExt as _, LocalBoxFuture};

    use super::*;
    use crate::model::Door;

    type Sent = LocalBoxFuture<'static, Result<PeerResponse, NoAnswer>>;

    fn json_text(answer: &str) -> Box<RawValue> {
        RawValue::from_string(answer.to_owned()).unwrap()
    }

    /// Returns the gaps between the uses sent within this time. `first` is the result of the first use.
    async fn gaps(within: Duration, first: Sent) -> Vec<Duration> {
        let (first, sent_at) = (RefCell::new(Some(first)), RefCell::new(vec![Instant::now()]));
        let send_use = || {
            sent_at.borrow_mut().push(Instant::now());
            first.take().unwrap_or_else(|| pending().boxed_local())
        };
        timeout(within, keep_lease(send_use)).await.unwrap_err();
        let sent_at = sent_at.into_inner();
        sent_at.windows(2).map(|two| two[1] - two[0]).collect()
    }

    #[tokio::test(start_paused = true)]
    async fn lease_is_used_on_time_whatever_the_answers() {
        let ttl = Duration::from_secs(8);
        let every = ttl / USES_A_TTL;
        let answered = || async { Ok(Ok(json_text(r#"{"ttl_ms": 8000}"#))) }.boxed_local();
        let used = gaps(Duration::from_mins(1), answered()).await;
        assert_eq!(used[0], MIN_TTL / USES_A_TTL, "its time to live is not known yet");
        assert!(used.len() > 20 && used[1..].iter().all(|gap| *gap == every), "{used:?}");
        // Without answers, uses continue at the shortest interval.
        for first in [pending().boxed_local(), async { Err(NoAnswer::None) }.boxed_local()] {
            let used = gaps(Duration::from_secs(10), first).await;
            assert!(used.len() > 50 && used.iter().all(|gap| *gap <= MIN_ANSWERED_WITHIN), "{used:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn ended_lease_is_not_used_again() {
        let refused = async { Ok(Err((CONFLICT, json_text(r#"{"code": "stale_lease"}"#)))) };
        assert_eq!(gaps(Duration::from_mins(1), refused.boxed_local()).await.len(), 1);
    }

    #[test]
    fn forwarded_name_has_the_whole_address_of_a_client() {
        let gateway: Name = "g".repeat(32).parse().unwrap();
        let name = |subject: &str| forwarded_name(&gateway, &Client::new(subject, Door::Http));
        for subject in ["http:2001:db8:1111:2222:3333:4444:5555:6666", &"n".repeat(32)] {
            assert_eq!(name(subject), format!("{gateway}/{subject}"));
        }
        let longest = name(&format!("zenoh:{}", "n".repeat(MAX_CLIENT_BYTES)));
        assert_eq!(longest.len(), MAX_CLIENT_BYTES);
    }

    #[tokio::test]
    async fn gone_gateway_gets_only_stops_and_lease_uses() {
        let name = |text: &str| text.parse::<Name>().unwrap();
        let network = Peers::new(name("cell-0"), crate::gripper::Grippers::new([]), None);
        network.take_token("wsg/v1/cell-1/alive", true);
        network.take_state("wsg/v1/cell-1/left/state", br#"{"link": "connected", "age_ms": 5, "fast_stop": false}"#);
        let urgency = |method| match method {
            "fast-stop" => Urgency::FastStop,
            "stop" | "cancel" => Urgency::Stop,
            "lease.renew" | "lease.release" => Urgency::Lease,
            _ => Urgency::None,
        };
        let ask = |method: &'static str| {
            let client = Client::new("anna", Door::Http);
            let (gateway, gripper, urgency) = (name("cell-1"), name("left"), urgency(method));
            let ask = PeerRequest {
                gateway,
                gripper: Some(gripper),
                method,
                params: json!({}),
                wait: None,
                aside: Vec::new(),
                client,
                urgency,
            };
            network.ask(ask)
        };
        // An attempt to send fails with this error, since Zenoh is off.
        let tried = Some(NoAnswer::Unknown);
        assert_eq!(ask("move").await.err(), tried);
        network.take_token("wsg/v1/cell-1/alive", false);
        for method in ["fast-stop", "stop", "cancel", "lease.renew", "lease.release"] {
            assert_eq!(ask(method).await.err(), tried, "{method}");
        }
        for method in ["move", "state", "lease.take"] {
            assert_eq!(ask(method).await.err(), Some(NoAnswer::Gone), "{method}");
        }
    }
}
