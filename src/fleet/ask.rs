//! Asking another gateway: one of its operations on one of its grippers, and its answer as it is.

use std::convert::Infallible;
use std::future::pending;
use std::time::Duration;

use futures_util::stream::{FuturesUnordered, StreamExt as _};
use serde::Deserialize;
use serde_json::value::RawValue;
use serde_json::{Value, json};
use tokio::time::{Instant, sleep, sleep_until, timeout};
use zenoh::Wait as _;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::qos::Priority;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::sample::Locality;

use super::Peers;
use super::keys::{self, Keys};
use super::twins::has_token;
use crate::gripper::Now;
use crate::gripper::model::lease::MIN_TTL;
use crate::gripper::model::{Client, Name, Urgency};

/// How long an answer may take on its way, beside what its operation may take.
const ON_ITS_WAY: Duration = Duration::from_secs(5);

/// How often a lease is used that is kept: two may be lost on their way, and the third take its time.
const USES_A_TTL: u32 = 4;

/// How many uses of a lease may wait for their answers: each may have a thread of its own for as long as Zenoh has no way
/// for it.
const MAX_USES_UNDER_WAY: usize = 2;

/// How long the answer to a use may take at least.
const MIN_ANSWERED_WITHIN: Duration = Duration::from_millis(250);

/// How often, and in which steps, the token of a session that answers is looked for.
const PROOFS: u32 = 10;
const PROVES_EVERY: Duration = Duration::from_millis(100);

/// Replies of sessions that may be looked at at a time: one gateway is asked, and sends one.
const MAX_PROOFS: usize = 16;

/// What asks for a lease itself, and keeps none.
const LEASE_METHODS: &str = "lease.";

/// The field that names a lease, and how it is refused that it is nobody's any more.
const LEASE: &str = "lease";
const CONFLICT: u16 = 409;

/// What is asked.
#[derive(Debug, Clone)]
pub struct Ask {
    /// Whom.
    pub gateway: Name,
    /// About which of its grippers.
    pub gripper: Name,
    /// The operation, by its method's name.
    pub method: &'static str,
    /// Its parameters.
    pub params: Value,
    /// How long it may take there; as long as that says where nothing is said.
    pub wait: Option<Duration>,
    /// What goes with them: `lease`, `request_id`.
    pub aside: Vec<(&'static str, String)>,
    /// Who asks here.
    pub client: Client,
    /// Before what it goes.
    pub urgency: Urgency,
}

/// The priority of a request on the network.
fn priority(urgency: Urgency) -> Priority {
    match urgency {
        Urgency::FastStop => Priority::RealTime,
        Urgency::Stop | Urgency::Lease => Priority::InteractiveHigh,
        Urgency::None => Priority::DataHigh,
    }
}

/// What was answered: a body, or a problem with its status.
pub type Asked = Result<Box<RawValue>, (u16, Box<RawValue>)>;

/// Why nothing was.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoAnswer {
    /// There is no gateway of this name.
    Unknown,
    /// It is gone: nothing was sent.
    Gone,
    /// Too much is being asked already: nothing was sent.
    TooMany,
    /// What became of it isn't known.
    None,
}

impl Peers {
    /// Asks the gateway that owns a gripper, and waits for its answer. For as long as that is waited for, and no longer, the
    /// lease that is named is kept.
    ///
    /// # Errors
    /// [`NoAnswer`], which says whether anything was sent.
    pub async fn ask(&self, ask: Ask) -> Result<Asked, NoAnswer> {
        match self.others().has_lost(&ask.gateway, &ask.gripper, Now::read().instant) {
            None => return Err(NoAnswer::Unknown),
            // What waits for a way there must not move later; what stops is worth the attempt, and so is a lease.
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

    /// A reply that comes from a session of this gateway. After an outage it may come before the session's token.
    async fn of_owner(&self, gateway: &Name, reply: Reply) -> Option<Reply> {
        let (session, replier) = (self.session.get()?, reply.replier_id()?.zid().to_string());
        for _ in 0..PROOFS {
            // Not in one condition, whose lock would be held meanwhile.
            let is_known = self.others().is_instance(gateway, &replier);
            if is_known || has_token(session, &Keys::of(gateway), &replier).await {
                return Some(reply);
            }
            sleep(PROVES_EVERY).await;
        }
        None
    }

    async fn send(&self, ask: Ask) -> Result<Asked, NoAnswer> {
        let session = self.session.get().cloned().ok_or(NoAnswer::Unknown)?;
        let key = Keys::of(&ask.gateway).gripper(&ask.gripper, &format!("command/{}", ask.method));
        let subject = ("client", format!("{}/{}", self.gateway, ask.client.subject));
        let wait_ms = ask.wait.map(|wait| ("wait_ms", wait.as_millis().to_string()));
        let parameters = [subject].into_iter().chain(wait_ms).chain(ask.aside);
        let parameters: Vec<_> = parameters.map(|(key, value)| format!("{key}={}", keys::encoded(&value))).collect();
        let within = ask.wait.unwrap_or_default() + ON_ITS_WAY;
        let (payload, urgency) = (ask.params.to_string(), ask.urgency);
        // It may wait for a place, and nobody else does there.
        let sent = tokio::task::spawn_blocking(move || {
            let get = session.get(format!("{key}?{}", parameters.join(";"))).payload(payload).timeout(within);
            let get = get.encoding(Encoding::APPLICATION_JSON).allowed_destination(Locality::Remote);
            // Of replies with the same key each comes: a stranger's takes the place of none.
            let get = get.target(QueryTarget::All).consolidation(ConsolidationMode::None);
            get.express(urgency == Urgency::FastStop).priority(priority(urgency)).wait()
        });
        let replies = sent.await.ok().and_then(Result::ok).ok_or(NoAnswer::None)?;
        let (mut proofs, mut refused) = (FuturesUnordered::new(), None);
        loop {
            let reply = tokio::select! {
                Some(reply) = proofs.next() => reply,
                Ok(reply) = replies.recv_async(), if proofs.len() < MAX_PROOFS => {
                    proofs.push(self.of_owner(&ask.gateway, reply));
                    continue;
                }
                else => break,
            };
            // Where several gateways of that name answer, it counts which of them has done it.
            match reply.as_ref().and_then(told) {
                Some(Ok(answer)) => return Ok(Ok(answer)),
                told => refused = told.or(refused),
            }
        }
        refused.ok_or(NoAnswer::None)
    }
}

/// Uses a lease as often as it needs, for as long as this is polled: the gateway that owns it does not see whether who
/// asks here is still there. Each use goes out in its time, whatever became of the one before.
async fn keep_lease<Sent: Future<Output = Result<Asked, NoAnswer>>>(send_use: impl Fn() -> Sent) -> Infallible {
    #[derive(Deserialize)]
    struct Renewed {
        ttl_ms: u64,
    }
    // Until it is known how long it lives.
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
                // It is nobody's any more.
                Ok(Ok(Err((CONFLICT, _)))) => return pending().await,
                _ => {}
            }
        }
    }
}

impl Ask {
    /// What keeps the lease that this names, where that is asked to be used and not to be changed.
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
            aside: Vec::new(),
            client: self.client.clone(),
            urgency: Urgency::Lease,
        })
    }
}

/// What a reply has; none where it is none of a gateway's: Zenoh's own say that the time is over.
fn told(reply: &Reply) -> Option<Asked> {
    #[derive(Deserialize)]
    struct Status {
        status: u16,
    }
    let json = |payload: &ZBytes| serde_json::from_slice(&payload.to_bytes()).ok();
    match reply.result() {
        Ok(sample) => Some(Ok(json(sample.payload())?)),
        Err(error) => {
            let problem: Box<RawValue> = json(error.payload())?;
            let Status { status } = serde_json::from_str(problem.get()).ok()?;
            Some(Err((status, problem)))
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use futures_util::future::{FutureExt as _, LocalBoxFuture};

    use super::*;
    use crate::gripper::model::Door;

    type Sent = LocalBoxFuture<'static, Result<Asked, NoAnswer>>;

    fn told(answer: &str) -> Box<RawValue> {
        RawValue::from_string(answer.to_owned()).unwrap()
    }

    /// How long after the one before each use goes out, within this time; what becomes of the first is said.
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
    async fn a_lease_is_used_in_its_time_whatever_becomes_of_a_use() {
        let ttl = Duration::from_secs(8);
        let every = ttl / USES_A_TTL;
        let answered = || async { Ok(Ok(told(r#"{"ttl_ms": 8000}"#))) }.boxed_local();
        let used = gaps(Duration::from_mins(1), answered()).await;
        assert_eq!(used[0], MIN_TTL / USES_A_TTL, "it is not known yet how long it lives");
        assert!(used.len() > 20 && used[1..].iter().all(|gap| *gap == every), "{used:?}");
        // Of the shortest none is lost between two of which nothing is heard.
        for first in [pending().boxed_local(), async { Err(NoAnswer::None) }.boxed_local()] {
            let used = gaps(Duration::from_secs(10), first).await;
            assert!(used.len() > 50 && used.iter().all(|gap| *gap <= MIN_ANSWERED_WITHIN), "{used:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_lease_that_is_nobodys_any_more_is_not_used() {
        let refused = async { Ok(Err((CONFLICT, told(r#"{"code": "stale_lease"}"#)))) };
        assert_eq!(gaps(Duration::from_mins(1), refused.boxed_local()).await.len(), 1);
    }

    #[tokio::test]
    async fn of_who_is_told_as_gone_only_what_stops_and_what_keeps_a_lease_is_asked() {
        let name = |text: &str| text.parse::<Name>().unwrap();
        let network = Peers::new(name("cell-0"), crate::gripper::Grippers::default());
        network.take_token("wsg/v1/cell-1/alive", true);
        network.take_state("wsg/v1/cell-1/left/state", br#"{"link": "connected", "age_ms": 5, "fast_stop": false}"#);
        let urgency = |method| match method {
            "fast-stop" => Urgency::FastStop,
            "stop" | "cancel" => Urgency::Stop,
            "lease.renew" | "lease.release" => Urgency::Lease,
            _ => Urgency::None,
        };
        let ask = |method: &'static str| {
            let client = Client { subject: "anna".into(), door: Door::Http };
            let (gateway, gripper, urgency) = (name("cell-1"), name("left"), urgency(method));
            let ask =
                Ask { gateway, gripper, method, params: json!({}), wait: None, aside: Vec::new(), client, urgency };
            network.ask(ask)
        };
        // There is no Zenoh to ask over, which is seen by who tries.
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
