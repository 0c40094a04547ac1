//! Queries: a gripper's `state` and `info`, the commands of a gripper and of the gateway, and the fleet. All are
//! operations of the API, so they are refused for the same reasons and in the same words.
//!
//! Sending a reply can block on a client that reads nothing, so each reply is sent from a thread that nobody waits for.
//! Such a client can occupy neither the slot of a FAST STOP nor all threads, because FAST STOPs to other gateways need
//! a thread.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use serde_json::value::{RawValue, to_raw_value};
use serde_json::{Map, Value};
use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use zenoh::Wait as _;
use zenoh::bytes::Encoding;
use zenoh::query::{Query, Queryable};
use zenoh::session::ZenohId;

use super::client::{client, identity};
use super::clients::{Clients, MAX_QUERIES};
use super::payloads::{body, holder, problem_json, with_bond};
use crate::access::{Credential, Identity, Right, Unauthorized};
use crate::connections::metrics::InterfaceMetrics;
use crate::fleet::keys::{COMMAND, ZenohKeys, decoded, last_part};
use crate::fleet::{EVENTS, GRIPS, READINESS, TOKEN};
use crate::model::{Client, Door, Name, Text, Urgency};
use crate::operations::gripper::{grippers, lease};
use crate::operations::parameters::nearest::did_you_mean;
use crate::operations::parameters::values::{name, text};
use crate::operations::readiness::Readiness;
use crate::operations::recipes::teach;
use crate::operations::records::RecordList;
use crate::operations::{
    self, Caller, Code, Effect, Gateway, MAX_LEASE_BYTES, Method, Operation, OperationReply, Presence, Problem, Wait,
    fleet, statistics,
};

/// Maximum number of concurrent FAST STOP queries of one gripper, each of which ends within 250 ms. More are refused,
/// since the gripper is already being stopped.
const MAX_FAST_STOPS: usize = 64;

/// Maximum number of concurrent reads of records, each with at most a hundred records.
const MAX_RECORD_READS: usize = 8;

/// Maximum number of threads for each of three kinds of replies: results of FAST STOPs, other results, and refusals for
/// lack of a slot. Together they leave a quarter of Tokio's 512 threads for other work that can block.
const MAX_SENDING: usize = 128;

/// The parameters of a query's selector.
const WAIT_MS: &str = "wait_ms";
const CLIENT: &str = "client";
/// The Zenoh id of the client's session, to which `lease.take` binds the lease.
const ZID: &str = "zid";
/// Parameters that are headers over HTTP.
const LEASE: &str = "lease";
const REQUEST_ID: &str = "request_id";

/// Commands that read many records.
const RECORD_READS: [&str; 2] = [statistics::STATISTICS.name, teach::TEACH.name];

/// Reads of a gripper besides its commands.
const GRIPPER_READS: [&Operation; 2] = [&grippers::STATE, &grippers::INFO];

/// Field that names the gripper, like the key.
const GRIPPER: &str = "gripper";

/// The queryables of one gateway.
#[derive(Debug)]
pub struct Queries {
    keys: ZenohKeys,
    gateway: Arc<Gateway>,
    clients: Arc<Clients>,
    metrics: InterfaceMetrics,
    runtime: Handle,
    slots: Arc<Semaphore>,
    /// Slots of queries that can wait for a command's end.
    waiting_slots: Arc<Semaphore>,
    /// Slots of queries that only stop, and can wait for a standstill.
    stop_slots: Arc<Semaphore>,
    /// Slots of queries that keep or end a lease, and wait for nothing.
    lease_slots: Arc<Semaphore>,
    /// Slots of reads of events, grip records and readiness.
    record_slots: Arc<Semaphore>,
    fast_stop_slots: Mutex<BTreeMap<Name, Arc<Semaphore>>>,
    /// Slots of FAST STOPs that name no gripper.
    fast_stop_all_slots: Arc<Semaphore>,
    sending_fast_stops: Arc<Semaphore>,
    sending_results: Arc<Semaphore>,
    sending_refusals: Arc<Semaphore>,
}

#[derive(Debug)]
struct ParsedQuery {
    key: String,
    method: Method,
    params: Map<String, Value>,
    wait_ms: Option<String>,
    /// Lease token from the selector.
    lease: Option<String>,
    request_id: Option<String>,
    credential: Credential,
    /// Session that takes a lease, as claimed by the client.
    zid: Option<ZenohId>,
    client: Client,
}

impl Queries {
    /// Returns queryables that run on the caller's runtime.
    pub fn new(keys: ZenohKeys, gateway: &Arc<Gateway>, clients: Arc<Clients>, metrics: InterfaceMetrics) -> Self {
        let runtime = Handle::current();
        let [slots, waiting_slots, stop_slots, lease_slots] = [MAX_QUERIES; 4].map(semaphore);
        Self {
            keys,
            gateway: gateway.clone(),
            clients,
            metrics,
            runtime,
            slots,
            waiting_slots,
            stop_slots,
            lease_slots,
            record_slots: semaphore(MAX_RECORD_READS),
            fast_stop_slots: Mutex::default(),
            fast_stop_all_slots: semaphore(MAX_FAST_STOPS),
            sending_fast_stops: semaphore(MAX_SENDING),
            sending_results: semaphore(MAX_SENDING),
            sending_refusals: semaphore(MAX_SENDING),
        }
    }

    /// Declares the queryables of a gripper, until they are dropped.
    pub async fn declare_gripper(
        self: &Arc<Self>,
        session: &zenoh::Session,
        gripper: &Name,
    ) -> zenoh::Result<[Queryable<()>; 3]> {
        let [state, info] = GRIPPER_READS;
        let state = self.declare_read(session, gripper, state).await?;
        let info = self.declare_read(session, gripper, info).await?;
        let queries = self.clone();
        let name = gripper.clone();
        let commands = session.declare_queryable(self.keys.command(Some(gripper), "*"));
        let commands = commands.callback(move |query| queries.command(query, Some(&name))).await?;
        Ok([state, info, commands])
    }

    async fn declare_read(
        self: &Arc<Self>,
        session: &zenoh::Session,
        gripper: &Name,
        operation: &'static Operation,
    ) -> zenoh::Result<Queryable<()>> {
        let queries = self.clone();
        let key = self.keys.gripper(gripper, operation.name);
        let params = Map::from_iter([(GRIPPER.to_owned(), gripper.as_str().into())]);
        let queryable = session.declare_queryable(key.clone());
        queryable.callback(move |query| queries.read(query, key.clone(), operation, params.clone())).await
    }

    /// Declares the queryables of the gateway and of the fleet.
    pub async fn declare(self: &Arc<Self>, session: &zenoh::Session) -> zenoh::Result<()> {
        for what in [EVENTS, GRIPS, READINESS] {
            let queries = self.clone();
            let reads = session.declare_queryable(self.keys.own(what));
            reads.callback(move |query| queries.of_gateway(query, what)).background().await?;
        }
        let queries = self.clone();
        let commands = session.declare_queryable(self.keys.command(None, "*"));
        commands.callback(move |query| queries.command(query, None)).background().await?;
        let queries = self.clone();
        let key = self.keys.own("fleet");
        let list = session.declare_queryable(key.clone());
        list.callback(move |query| queries.read(query, key.clone(), &fleet::LIST, Map::new())).background().await
    }

    fn read(self: &Arc<Self>, query: Query, key: String, operation: &'static Operation, params: Map<String, Value>) {
        let asked = ParsedQuery {
            key,
            method: operation.into(),
            params,
            wait_ms: None,
            lease: None,
            request_id: None,
            credential: Credential::None,
            zid: None,
            client: client(None),
        };
        self.answer(query, Ok(asked));
    }

    /// Answers a read of the gateway as a whole.
    fn of_gateway(self: &Arc<Self>, query: Query, what: &'static str) {
        let slot = self.record_slots.clone().try_acquire_owned().ok();
        let queries = self.clone();
        self.runtime.spawn(async move {
            if slot.is_none() {
                let detail = format!("too many reads of records ({MAX_RECORD_READS} in progress): try again later");
                let problem = Problem::new(Code::Overloaded, detail);
                return queries.reply(&queries.sending_refusals, query, None, Err(problem), None).await;
            }
            let payload = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
            let result = queries.gateway_read(what, &payload).await;
            let status = result.as_ref().map_or_else(|problem| problem.status().as_u16(), |_| 200);
            queries.metrics.answered(Some(what), "QUERY", status);
            queries.reply(&queries.sending_results, query, Some(queries.keys.own(what)), result, slot).await;
        });
    }

    async fn gateway_read(&self, what: &str, payload: &[u8]) -> Result<Box<RawValue>, Problem> {
        operations::require(&self.gateway.access.of_network(), Right::Read, None)?;
        let list = match what {
            EVENTS => RecordList::Events,
            GRIPS => RecordList::Grips,
            _ => return to_raw_value(&Readiness::of(&self.gateway)).map_err(|_| Problem::internal()),
        };
        let uri = std::str::from_utf8(payload).ok().and_then(|query| format!("/?{query}").parse().ok());
        let uri = uri.ok_or_else(|| Problem::malformed("query", "the payload must be the query of an HTTP request"))?;
        list.body(&self.gateway, &list.short_page(&self.gateway, &uri).await?)
    }

    /// Answers a query for a command of a gripper, or of the gateway itself.
    fn command(self: &Arc<Self>, query: Query, gripper: Option<&Name>) {
        let key = query.key_expr().as_str();
        let method = Method::named(last_part(key)).ok();
        if gripper.is_none() && !is_of_gateway(key) && !method.is_some_and(Method::is_fast_stop) {
            return;
        }
        let asked = self.asked(&query, gripper, method);
        self.answer(query, asked);
    }

    /// Parses a query for a command. A FAST STOP is accepted whatever its parameters.
    fn asked(&self, query: &Query, gripper: Option<&Name>, method: Option<Method>) -> Result<ParsedQuery, Problem> {
        let name_in_key = last_part(query.key_expr().as_str());
        let key = self.keys.command(gripper, name_in_key);
        let is_exact = key == query.key_expr().as_str() && !name_in_key.contains('*');
        if !is_exact && !method.is_some_and(Method::is_fast_stop) {
            let detail = "the key of a command must name exactly one gateway, and one gripper for a gripper's command: only \
                          FAST STOPs can have wildcards";
            return Err(Problem::malformed("key", detail));
        }
        let of_gripper = gripper.is_some();
        let known =
            method.filter(|method| method.operations().any(|operation| operation.is_of_gripper() == of_gripper));
        let Some(method) = known else { return Err(no_such_command(name_in_key, of_gripper)) };
        if self.gateway.peers.has_twin() && method.urgency() == Urgency::None {
            let detail = "another gateway on the Zenoh network has the same name and would also run this command: give \
                          each its own --name";
            return Err(Problem::new(Code::NameTaken, detail));
        }
        let payload = query.payload().map(zenoh::bytes::ZBytes::to_bytes).unwrap_or_default();
        let client_name = parameter(query, CLIENT).map(|given| name(CLIENT, &given)).transpose();
        let ignores_mistakes = method.shared().ignores_mistakes;
        let (mut params, client_name) = if ignores_mistakes {
            (body(&payload).unwrap_or_default(), client_name.unwrap_or_default())
        } else {
            (body(&payload)?, client_name?)
        };
        if let Some(gripper) = gripper {
            let other = params.insert(GRIPPER.to_owned(), gripper.as_str().into());
            let differs = other.is_some_and(|other| !other.is_null() && other != gripper.as_str());
            if !ignores_mistakes && differs {
                return Err(Problem::malformed(GRIPPER, "gripper differs from the gripper in the key"));
            }
        }
        let takes_lease = method == Method::from(&lease::TAKE);
        let zid = parameter(query, ZID).filter(|_| takes_lease).map(|zid| session_id(&zid)).transpose()?;
        Ok(ParsedQuery {
            key,
            method,
            params,
            wait_ms: parameter(query, WAIT_MS),
            zid,
            lease: parameter(query, LEASE),
            request_id: parameter(query, REQUEST_ID),
            credential: parameter(query, TOKEN).map_or(Credential::None, |token| Credential::of_token(&token)),
            client: client(client_name.as_ref()),
        })
    }

    /// Answers a query, or refuses it if too many are in progress.
    fn answer(self: &Arc<Self>, query: Query, asked: Result<ParsedQuery, Problem>) {
        let slots = asked.as_ref().map_or_else(|_| self.slots.clone(), |asked| self.slots_for(asked));
        let slot = slots.try_acquire_owned().ok();
        let queries = self.clone();
        self.runtime.spawn(async move {
            let is_fast_stop = asked.as_ref().is_ok_and(|asked| asked.method.is_fast_stop());
            let (key, result) = match asked {
                _ if slot.is_none() => {
                    tracing::warn!(key = %query.key_expr(), "Zenoh query refused: too many in progress");
                    let detail = format!("too many Zenoh queries ({MAX_QUERIES} in progress): wait for their replies");
                    (None, Err(Problem::new(Code::Overloaded, detail)))
                }
                Ok(asked) => (Some(asked.key.clone()), queries.call(asked).await),
                Err(problem) => (None, Err(problem)),
            };
            let sending = match &slot {
                None => &queries.sending_refusals,
                Some(_) if is_fast_stop => &queries.sending_fast_stops,
                Some(_) => &queries.sending_results,
            };
            queries.reply(sending, query, key, result, slot.filter(|_| !is_fast_stop)).await;
        });
    }

    /// Returns the slots for a query. Queries that wait, queries that don't, and FAST STOPs have separate slots. The
    /// holder of a lease that was taken via Zenoh has slots of its own.
    fn slots_for(&self, asked: &ParsedQuery) -> Arc<Semaphore> {
        let gripper = asked.params.get(GRIPPER).and_then(Value::as_str).unwrap_or_default();
        let holders = asked.lease().and_then(|lease| self.clients.slots_of(gripper, lease)).unwrap_or_default();
        let is_command = asked.method.shared().starts_command;
        let (holders, all) = match asked.method.urgency() {
            Urgency::FastStop => {
                let name = gripper.parse().ok().filter(|name| self.gateway.grippers.get(name).is_some());
                let Some(name) = name else { return self.fast_stop_all_slots.clone() };
                let mut slots = self.fast_stop_slots.lock().unwrap_or_else(PoisonError::into_inner);
                return slots.entry(name).or_insert_with(|| semaphore(MAX_FAST_STOPS)).clone();
            }
            Urgency::Stop => (holders.stops, &self.stop_slots),
            Urgency::Lease => (holders.others, &self.lease_slots),
            Urgency::None if RECORD_READS.contains(&asked.method.name()) => return self.record_slots.clone(),
            Urgency::None if asked.wait_ms.is_some() || is_command => (holders.waiting, &self.waiting_slots),
            Urgency::None => (holders.others, &self.slots),
        };
        holders.unwrap_or_else(|| all.clone())
    }

    async fn call(&self, asked: ParsedQuery) -> Result<Box<RawValue>, Problem> {
        let caller = self.caller(&asked);
        let ParsedQuery { method, params, zid, credential, .. } = asked;
        let bond =
            if method == Method::from(&lease::TAKE) { self.clients.bond(holder(&params), zid).await } else { None };
        let result = operations::call(&self.gateway, caller, method, Value::Object(params)).await;
        let status = result.as_ref().map_or_else(|problem| problem.status().as_u16(), |_| 200);
        self.metrics.answered(Some(method.name()), "QUERY", status);
        let OperationReply { body, effect, .. } = result?;
        let Effect::Leased(lease) = effect else { return Ok(body) };
        let with_bond = with_bond(&body, bond.as_ref());
        self.clients.bind(bond, lease, credential);
        Ok(with_bond.unwrap_or(body))
    }

    fn caller(&self, asked: &ParsedQuery) -> Caller {
        let lease = asked.lease.as_deref().map(|given| text::<MAX_LEASE_BYTES>(LEASE, given)).transpose();
        let request_id = asked.request_id.as_deref().map(|given| text(REQUEST_ID, given)).transpose();
        let identity = self.identity(asked);
        let name = identity.as_ref().ok().and_then(|identity| identity.name.as_ref());
        let client = name.map_or_else(|| asked.client.clone(), |name| Client::new(name.as_str(), Door::Zenoh));
        Caller {
            client,
            identity,
            lease: lease.map(|lease: Option<Text<MAX_LEASE_BYTES>>| lease.map(|lease| lease.as_str().into())),
            request_id,
            presence: self.presence(asked),
            wait: Wait::Ms { given: asked.wait_ms.clone(), limiter: None },
        }
    }

    fn identity(&self, asked: &ParsedQuery) -> Result<Identity, Unauthorized> {
        // A wrong token must not prevent a FAST STOP that needs none on this network.
        let credential = if asked.method.is_fast_stop() { &Credential::None } else { &asked.credential };
        identity(&self.gateway.access, credential)
    }

    /// Returns whether the client's loss would be noticed. Zenoh reports only the end of a client's session or token,
    /// not that the client of an open query is gone.
    fn presence(&self, asked: &ParsedQuery) -> Presence {
        let gripper = asked.params.get(GRIPPER).and_then(Value::as_str);
        let is_seen = gripper.zip(asked.lease()).is_some_and(|(gripper, lease)| self.clients.has_bound(gripper, lease));
        if is_seen { Presence::Seen } else { Presence::Unseen }
    }

    /// Sends a reply from a thread that can block. The slot stays occupied until that thread has sent the reply.
    async fn reply(
        &self,
        sending: &Arc<Semaphore>,
        query: Query,
        key: Option<String>,
        result: Result<Box<RawValue>, Problem>,
        slot: Option<OwnedSemaphorePermit>,
    ) {
        let sends = sending.clone().acquire_owned().await.ok();
        self.runtime.spawn_blocking(move || {
            let json = Encoding::APPLICATION_JSON;
            let sent = match (key, result) {
                (Some(key), Ok(body)) => query.reply(key, body.get()).encoding(json).wait(),
                (None, Ok(body)) => query.reply(query.key_expr(), body.get()).encoding(json).wait(),
                (_, Err(problem)) => query.reply_err(problem_json(&problem)).encoding(json).wait(),
            };
            if let Err(error) = sent {
                tracing::debug!(%error, "Zenoh reply not sent: the client is gone");
            }
            drop((query, slot, sends));
        });
    }
}

fn semaphore(slots: usize) -> Arc<Semaphore> {
    Arc::new(Semaphore::new(slots))
}

/// Returns a parameter of a query's selector. An empty one counts as absent.
fn parameter(query: &Query, key: &str) -> Option<String> {
    query.parameters().get(key).filter(|given| !given.is_empty()).map(decoded)
}

/// Returns the problem for a command that grippers, or the gateway itself, do not have.
fn no_such_command(name: &str, of_gripper: bool) -> Problem {
    let here = operations::all().filter(|operation| operation.is_of_gripper() == of_gripper);
    let suggestion = did_you_mean(name, here.map(|operation| operation.name));
    Problem::not_found(format!("such command{suggestion}; /api/v1/asyncapi.yaml lists all commands"))
}

/// Whether a key that matches `command/*` of a gateway means its commands. `*/*/state` matches too, and means the states
/// of all grippers, one of which can be called `command`.
fn is_of_gateway(key: &str) -> bool {
    let (before, method) = key.rsplit_once('/').unwrap_or_default();
    last_part(before) == COMMAND && !GRIPPER_READS.iter().any(|read| read.name == method)
}

impl ParsedQuery {
    fn lease(&self) -> Option<&str> {
        let field = self.params.get(LEASE).and_then(Value::as_str);
        field.or(self.lease.as_deref())
    }
}

fn session_id(zid: &str) -> Result<ZenohId, Problem> {
    zid.parse().map_err(|_| {
        Problem::malformed(ZID, "zid must be the Zenoh id of the client's own session, in hexadecimal digits")
    })
}

#[cfg(test)]
mod tests {
    use prometheus::Registry;

    use super::*;
    use crate::gripper::fake::{self, FakeScript};

    fn asked(gripper: &str, method: &str, wait_ms: Option<&str>) -> ParsedQuery {
        ParsedQuery {
            key: String::new(),
            method: Method::named(method).unwrap(),
            params: Map::from_iter([("gripper".to_owned(), gripper.into())]),
            wait_ms: wait_ms.map(ToOwned::to_owned),
            lease: None,
            request_id: None,
            credential: Credential::None,
            zid: None,
            client: super::client(None),
        }
    }

    #[tokio::test]
    async fn each_lane_has_its_own_slots() {
        let grippers = ["left", "right"].map(|name| fake::gripper(name, FakeScript::default()).0);
        let gateway = Gateway::of(grippers);
        let metrics = InterfaceMetrics::register(&Registry::new(), "zenoh").unwrap();
        let keys = ZenohKeys::of(&gateway.name);
        let clients = Arc::new(Clients::new(keys.clone(), Handle::current(), metrics.clone(), gateway.access.clone()));
        let queries = Queries::new(keys, &gateway, clients, metrics);
        let lanes = [
            asked("left", "move", None),
            asked("left", "command", Some("60000")),
            asked("left", "state", None),
            asked("left", "stop", Some("60000")),
            asked("left", "cancel", None),
            asked("left", "lease.renew", None),
            asked("left", "fast-stop", None),
            asked("right", "fast-stop", Some("60000")),
            asked("", "fast-stop", None),
        ];
        // Queries of one lane share slots.
        let lane_of = [0, 0, 1, 2, 2, 3, 4, 5, 6];
        for (asked, lane) in lanes.iter().zip(lane_of) {
            let slots = queries.slots_for(asked);
            let all: Vec<_> = std::iter::from_fn(|| slots.clone().try_acquire_owned().ok()).collect();
            assert!(!all.is_empty() && all.len() <= MAX_QUERIES.max(MAX_FAST_STOPS), "{:?}", asked.method);
            for (other, other_lane) in lanes.iter().zip(lane_of) {
                let has_place = queries.slots_for(other).try_acquire_owned().is_ok();
                assert_eq!(has_place, lane != other_lane, "{:?} while {:?} has all", other.method, asked.method);
            }
        }
    }
}
