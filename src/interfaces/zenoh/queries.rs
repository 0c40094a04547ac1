//! Queries: a gripper's `state` and `info`, its commands, and the fleet. All of them are operations of the API, so what is
//! refused there is refused here, in the same words.
//!
//! A reply may wait for a client that takes none, so each is sent from a thread where nobody else waits.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::Deserialize;
use serde_json::value::RawValue;
use serde_json::{Map, Value};
use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use zenoh::Wait as _;
use zenoh::bytes::Encoding;
use zenoh::query::Query;
use zenoh::session::ZenohId;

use super::client::client;
use super::clients::{Bond, Clients, MAX_QUERIES};
use crate::fleet::keys::{Keys, decoded, last_part};
use crate::gripper::Grippers;
use crate::gripper::model::{Client, Name, Text, Urgency};
use crate::interfaces::metrics::Metrics;
use crate::operations::json::{self, MAX_BODY_BYTES, StrictJson};
use crate::operations::values::{name, text};
use crate::operations::{
    self, Caller, Code, Effect, Gateway, MAX_LEASE_BYTES, Presence, Problem, Reply, Wait, is_fast_stop, lease, named,
    urgency,
};

/// And FAST STOPs of one gripper among the queries, each of which ends within 250 ms: one more is under way already.
const MAX_FAST_STOPS: usize = 64;

/// The parameters of a query's selector.
const WAIT_MS: &str = "wait_ms";
const CLIENT: &str = "client";
/// The Zenoh id of the client's session, to which `lease.take` binds the lease.
const ZID: &str = "zid";
/// Those that are headers over HTTP.
const LEASE: &str = "lease";
const REQUEST_ID: &str = "request_id";

/// The field that names the gripper, as the key does.
const GRIPPER: &str = "gripper";

/// The field of its answer that says what the lease is bound to.
const BOUND_TO: &str = "bound_to";

/// Who answers.
#[derive(Debug)]
pub struct Queries {
    keys: Keys,
    gateway: Arc<Gateway>,
    clients: Arc<Clients>,
    metrics: Metrics,
    runtime: Handle,
    places: Arc<Semaphore>,
    /// Of those that may wait for a command's end.
    waiting_places: Arc<Semaphore>,
    /// Of those that only stop, and may wait until the fingers stand.
    stop_places: Arc<Semaphore>,
    /// Of those that keep or end a lease, and wait for nobody.
    lease_places: Arc<Semaphore>,
    fast_stop_places: BTreeMap<Name, Arc<Semaphore>>,
}

/// What a query asks for.
#[derive(Debug)]
struct Asked {
    /// Under which key it is answered.
    key: String,
    /// The operation.
    method: String,
    params: Map<String, Value>,
    wait_ms: Option<String>,
    /// The lease token and the request id of the selector.
    lease: Option<String>,
    request_id: Option<String>,
    /// The session that asks for a lease, as it says itself.
    zid: Option<ZenohId>,
    client: Client,
}

impl Queries {
    /// On the runtime that this is called on.
    pub fn new(keys: Keys, gateway: &Arc<Gateway>, clients: Arc<Clients>, metrics: Metrics) -> Self {
        let runtime = Handle::current();
        let semaphore = |places| Arc::new(Semaphore::new(places));
        let [places, waiting_places, stop_places, lease_places] = [MAX_QUERIES; 4].map(semaphore);
        let names = gateway.grippers.iter().map(crate::gripper::Handle::name);
        let fast_stop_places = names.map(|name| (name.clone(), semaphore(MAX_FAST_STOPS))).collect();
        Self {
            keys,
            gateway: gateway.clone(),
            clients,
            metrics,
            runtime,
            places,
            waiting_places,
            stop_places,
            lease_places,
            fast_stop_places,
        }
    }

    /// Takes queries for these grippers.
    pub async fn declare(self: &Arc<Self>, session: &zenoh::Session, fleet: &Grippers) -> zenoh::Result<()> {
        for gripper in fleet.iter().map(crate::gripper::Handle::name) {
            for what in ["state", "info"] {
                let (queries, key) = (self.clone(), self.keys.gripper(gripper, what));
                let params = Map::from_iter([(GRIPPER.to_owned(), gripper.as_str().into())]);
                let answered = key.clone();
                let answer = move |query: Query| queries.read(query, answered.clone(), what, params.clone());
                session.declare_queryable(key).callback(answer).background().await?;
            }
            let (queries, gripper, key) = (self.clone(), gripper.clone(), self.keys.gripper(gripper, "command/*"));
            let answer = move |query: Query| queries.command(query, &gripper);
            session.declare_queryable(key).callback(answer).background().await?;
        }
        let (queries, key) = (self.clone(), self.keys.own("fleet"));
        let answer = move |query: Query| queries.read(query, queries.keys.own("fleet"), "fleet", Map::new());
        session.declare_queryable(key).callback(answer).background().await
    }

    fn read(self: &Arc<Self>, query: Query, key: String, what: &'static str, params: Map<String, Value>) {
        let asked = Asked {
            key,
            method: what.to_owned(),
            params,
            wait_ms: None,
            lease: None,
            request_id: None,
            zid: None,
            client: client(None),
        };
        self.answer(query, Ok(asked));
    }

    fn command(self: &Arc<Self>, query: Query, gripper: &Name) {
        let asked = self.asked(&query, gripper);
        self.answer(query, asked);
    }

    /// What a query for a command asks for. One for a FAST STOP is one whatever comes with it.
    fn asked(&self, query: &Query, gripper: &Name) -> Result<Asked, Problem> {
        let method = last_part(query.key_expr().as_str()).to_owned();
        let is_fast_stop = is_fast_stop(&method);
        let key = self.keys.gripper(gripper, &format!("command/{method}"));
        if (key != query.key_expr().as_str() || method.contains('*')) && !is_fast_stop {
            let detail =
                "a command is asked of one gripper, by its name: only FAST STOPs may have wildcards in their key";
            return Err(Problem::malformed("key", detail));
        }
        if !named(&method).any(operations::Operation::is_of_gripper) {
            return Err(Problem::not_found("such command: the API's description has them all"));
        }
        if self.gateway.peers.has_twin() && urgency(&method) == Urgency::None {
            let detail = "another gateway on the Zenoh network has the name of this one, and would do it, too: give each its own";
            return Err(Problem::new(Code::NameTaken, detail));
        }
        let payload = query.payload().map(zenoh::bytes::ZBytes::to_bytes).unwrap_or_default();
        let given = |key| query.parameters().get(key).filter(|given| !given.is_empty()).map(decoded);
        let client_name = given(CLIENT).map(|given| name(CLIENT, &given)).transpose();
        let (mut params, client_name) = if is_fast_stop {
            (json::parse(&payload).unwrap_or_default(), client_name.unwrap_or_default())
        } else {
            (body(&payload)?, client_name?)
        };
        let other = params.insert("gripper".to_owned(), gripper.as_str().into());
        if !is_fast_stop && other.is_some_and(|other| other != gripper.as_str()) {
            return Err(Problem::malformed("gripper", "gripper is another one than that of the key"));
        }
        let zid = given(ZID).filter(|_| method == lease::TAKE.name).map(|zid| session_id(&zid)).transpose()?;
        Ok(Asked {
            key,
            method,
            params,
            wait_ms: given(WAIT_MS),
            zid,
            lease: given(LEASE),
            request_id: given(REQUEST_ID),
            client: client(client_name.as_ref()),
        })
    }

    /// Answers in its turn; refuses where too many are under way.
    fn answer(self: &Arc<Self>, query: Query, asked: Result<Asked, Problem>) {
        let places = asked.as_ref().map_or_else(|_| self.places.clone(), |asked| self.places_for(asked));
        let Ok(place) = places.try_acquire_owned() else {
            tracing::warn!(key = %query.key_expr(), "too many Zenoh queries are under way");
            let detail = format!("{MAX_QUERIES} Zenoh queries are under way already: await their answers first");
            self.reply(query, None, Err(Problem::new(Code::Overloaded, detail)), None);
            return;
        };
        let queries = self.clone();
        self.runtime.spawn(async move {
            let (key, told) = match asked {
                Ok(asked) => (Some(asked.key.clone()), queries.call(asked).await),
                Err(problem) => (None, Err(problem)),
            };
            queries.reply(query, key, told, Some(place));
        });
    }

    /// A query that waits takes no place of one that doesn't, and none takes a place of a FAST STOP. The holder of a lease
    /// that was taken through Zenoh has places of its own.
    fn places_for(&self, asked: &Asked) -> Arc<Semaphore> {
        let gripper = asked.params.get(GRIPPER).and_then(Value::as_str).unwrap_or_default();
        let holders = asked.lease().and_then(|lease| self.clients.places_of(gripper, lease)).unwrap_or_default();
        let is_command = named(&asked.method).any(|operation| operation.starts_command);
        let (holders, all) = match urgency(&asked.method) {
            Urgency::FastStop => {
                let name = gripper.parse().ok();
                (None, name.and_then(|name: Name| self.fast_stop_places.get(&name)).unwrap_or(&self.places))
            }
            Urgency::Stop => (holders.stops, &self.stop_places),
            Urgency::Lease => (holders.others, &self.lease_places),
            Urgency::None if asked.wait_ms.is_some() || is_command => (holders.waiting, &self.waiting_places),
            Urgency::None => (holders.others, &self.places),
        };
        holders.unwrap_or_else(|| all.clone())
    }

    async fn call(&self, asked: Asked) -> Result<Box<RawValue>, Problem> {
        let caller = self.caller(&asked);
        let Asked { method, params, zid, .. } = asked;
        let bond = if method == lease::TAKE.name { self.clients.bond(holder(&params), zid).await } else { None };
        let result = operations::call(&self.gateway, caller, &method, Value::Object(params)).await;
        let status = result.as_ref().map_or_else(|problem| problem.status().as_u16(), |_| 200);
        self.metrics.answered(Some(&method), "QUERY", status);
        let Reply { body, effect } = result?;
        let Effect::Leased(lease) = effect else { return Ok(body) };
        let with_bond = with_bond(&body, bond.as_ref());
        self.clients.bind(bond, lease);
        Ok(with_bond.unwrap_or(body))
    }

    fn caller(&self, asked: &Asked) -> Caller {
        let lease = asked.lease.as_deref().map(|given| text::<MAX_LEASE_BYTES>(LEASE, given)).transpose();
        let request_id = asked.request_id.as_deref().map(|given| text(REQUEST_ID, given)).transpose();
        Caller {
            client: asked.client.clone(),
            lease: lease.map(|lease: Option<Text<MAX_LEASE_BYTES>>| lease.map(|lease| lease.as_str().into())),
            request_id,
            presence: self.presence(asked),
            wait: Wait::Ms { given: asked.wait_ms.clone(), limiter: None },
        }
    }

    /// Zenoh reports the end of a client's session or token alone, and not that the client of an open query is gone.
    fn presence(&self, asked: &Asked) -> Presence {
        let gripper = asked.params.get(GRIPPER).and_then(Value::as_str);
        let is_seen = gripper.zip(asked.lease()).is_some_and(|(gripper, lease)| self.clients.has_bound(gripper, lease));
        if is_seen { Presence::Seen } else { Presence::Unseen }
    }

    /// Sends a reply from where it may wait.
    fn reply(
        &self,
        query: Query,
        key: Option<String>,
        told: Result<Box<RawValue>, Problem>,
        place: Option<OwnedSemaphorePermit>,
    ) {
        self.runtime.spawn_blocking(move || {
            let json = Encoding::APPLICATION_JSON;
            let sent = match (key, told) {
                (Some(key), Ok(body)) => query.reply(key, body.get()).encoding(json).wait(),
                (None, Ok(body)) => query.reply(query.key_expr(), body.get()).encoding(json).wait(),
                (_, Err(problem)) => query.reply_err(problem_json(&problem)).encoding(json).wait(),
            };
            if let Err(error) = sent {
                tracing::debug!(%error, "a Zenoh reply is not sent: who asked is gone");
            }
            drop((query, place));
        });
    }
}

/// A query's payload, within the bounds of a request's body.
fn body(payload: &[u8]) -> Result<Map<String, Value>, Problem> {
    if payload.len() > MAX_BODY_BYTES {
        let (bytes, max) = (payload.len(), MAX_BODY_BYTES);
        let detail = format!("the payload has {bytes} bytes, and may have {max} at most");
        return Err(Problem::new(Code::TooLarge, detail).value(Some(bytes.into())).limits(None, Some(max.into())));
    }
    match json::parse(payload)? {
        StrictJson(Value::Object(params)) => Ok(params),
        // Nothing else is a body.
        StrictJson(_) => Ok(Map::new()),
    }
}

fn problem_json(problem: &Problem) -> String {
    serde_json::to_string(problem).unwrap_or_default()
}

impl Asked {
    /// The lease that the query names.
    fn lease(&self) -> Option<&str> {
        let field = self.params.get(LEASE).and_then(Value::as_str);
        field.or(self.lease.as_deref())
    }
}

/// The answer to `lease.take`, with what the lease is bound to.
fn with_bond(lease: &RawValue, bond: Option<&Bond>) -> Option<Box<RawValue>> {
    let mut lease: Map<String, Value> = serde_json::from_str(lease.get()).ok()?;
    lease.insert(BOUND_TO.to_owned(), bond.map(Bond::name).into());
    serde_json::value::to_raw_value(&lease).ok()
}

fn session_id(zid: &str) -> Result<ZenohId, Problem> {
    zid.parse().map_err(|_| {
        Problem::malformed(ZID, "zid must be a Zenoh id: that of the client's own session, in hexadecimal digits")
    })
}

/// By which name a lease is asked for.
fn holder(params: &Map<String, Value>) -> Option<String> {
    #[derive(Deserialize)]
    struct Take {
        holder: String,
    }
    Take::deserialize(params).ok().map(|Take { holder }| holder)
}

#[cfg(test)]
mod tests {
    use prometheus::Registry;

    use super::*;
    use crate::gripper::fake::{self, Script};

    fn asked(gripper: &str, method: &str, wait_ms: Option<&str>) -> Asked {
        Asked {
            key: String::new(),
            method: method.to_owned(),
            params: Map::from_iter([("gripper".to_owned(), gripper.into())]),
            wait_ms: wait_ms.map(ToOwned::to_owned),
            lease: None,
            request_id: None,
            zid: None,
            client: super::client(None),
        }
    }

    #[tokio::test]
    async fn nobody_takes_the_place_of_who_waits_less_nor_one_of_a_fast_stop() {
        let grippers = ["left", "right"].map(|name| fake::gripper(name, Script::default()).0);
        let gateway = Gateway::of(grippers);
        let metrics = Metrics::register(&Registry::new(), "zenoh").unwrap();
        let keys = Keys::of(&gateway.name);
        let clients = Arc::new(Clients::new(keys.clone(), Handle::current(), metrics.clone()));
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
        ];
        // Those of one lane stand behind each other.
        let lane_of = [0, 0, 1, 2, 2, 3, 4, 5];
        for (asked, lane) in lanes.iter().zip(lane_of) {
            let places = queries.places_for(asked);
            let all: Vec<_> = std::iter::from_fn(|| places.clone().try_acquire_owned().ok()).collect();
            assert!(!all.is_empty() && all.len() <= MAX_QUERIES.max(MAX_FAST_STOPS), "{}", asked.method);
            for (other, other_lane) in lanes.iter().zip(lane_of) {
                let has_place = queries.places_for(other).try_acquire_owned().is_ok();
                assert_eq!(has_place, lane != other_lane, "{} while {} has all", other.method, asked.method);
            }
        }
    }
}
