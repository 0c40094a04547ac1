//! Targets of servo sessions via a put, which gets no answer. A newer one replaces one of the same client that waits.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex, PoisonError};

use futures_util::FutureExt as _;
use futures_util::stream::{FuturesUnordered, StreamExt as _};
use serde_json::{Map, Value};
use tokio::sync::Notify;
use tokio_util::task::AbortOnDropHandle;
use zenoh::pubsub::Subscriber;

use super::client::{client, identity};
use super::payloads::body;
use crate::access::Credential;
use crate::fleet::TOKEN;
use crate::fleet::keys::{MAX_CLIENT_BYTES, ZenohKeys};
use crate::interfaces::Context;
use crate::model::{Client, Door, Name, ShownName};
use crate::operations::gripper::servo;
use crate::operations::{self, Caller, Gateway, Method, Operation};

/// Fields that are parameters of the selector in a query.
const CLIENT: &str = "client";

/// Field that names the gripper, like the key.
const GRIPPER: &str = "gripper";

/// Operations that a put can request.
const PUTS: [&Operation; 2] = [&servo::TARGET, &servo::FOLLOW];

/// The targets of one gripper, until this is dropped.
#[derive(Debug)]
pub struct ServoTargets {
    _subscribers: Vec<Subscriber<()>>,
    _running: AbortOnDropHandle<()>,
}

/// Most clients whose puts wait at the same time, and most whose puts are executed. A put of a further one is lost.
const MAX_CLIENTS: usize = 16;

/// The fields of a put that say who the client is: `client` and `token`.
type PutClient = (Option<String>, Option<String>);

fn client_of(fields: &Map<String, Value>) -> PutClient {
    (field(fields, CLIENT), field(fields, TOKEN))
}

fn field(fields: &Map<String, Value>, key: &str) -> Option<String> {
    fields.get(key)?.as_str().map(ToOwned::to_owned)
}

#[derive(Debug)]
struct Put {
    operation: &'static Operation,
    fields: Map<String, Value>,
}

/// The newest put of each client, until it is executed. So the puts of a client that does not steer, and the delayed
/// answers to them, cost the client that steers no target.
#[derive(Debug, Default)]
struct NewestPuts {
    waiting: Mutex<HashMap<PutClient, Put>>,
    added: Notify,
}

impl NewestPuts {
    /// Returns whether there is room for the put.
    fn add(&self, put: Put) -> bool {
        let client = client_of(&put.fields);
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let has_room = waiting.len() < MAX_CLIENTS || waiting.contains_key(&client);
        if has_room {
            waiting.insert(client, put);
            self.added.notify_one();
        }
        has_room
    }

    /// Takes puts of other clients than these, as many as can be executed.
    fn take_except(&self, busy: &HashSet<PutClient>) -> Vec<(PutClient, Put)> {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let free = MAX_CLIENTS.saturating_sub(busy.len());
        waiting.extract_if(|client, _| !busy.contains(client)).take(free).collect()
    }
}

impl ServoTargets {
    /// Subscribes to the keys of a gripper. Targets are executed on the runtime of the sockets, like those over WebSocket:
    /// its one thread wakes no other one first.
    pub async fn declare(
        session: &zenoh::Session,
        keys: &ZenohKeys,
        context: &Context,
        gripper: &Name,
    ) -> zenoh::Result<Self> {
        let newest = Arc::new(NewestPuts::default());
        let running = context.runtimes.sockets.spawn(run(newest.clone(), context.clone(), gripper.clone()));
        let mut subscribers = Vec::new();
        for operation in PUTS {
            let newest = newest.clone();
            let metrics = context.metrics.clone();
            let subscriber = session.declare_subscriber(keys.command(Some(gripper), operation.name));
            let subscriber = subscriber.callback(move |sample| {
                let refused = match body(&sample.payload().to_bytes()) {
                    Ok(fields) => (!newest.add(Put { operation, fields })).then_some(503),
                    Err(problem) => Some(problem.status().as_u16()),
                };
                if let Some(status) = refused {
                    metrics.answered(Some(operation.name), "PUT", status);
                }
            });
            subscribers.push(subscriber.await?);
        }
        Ok(Self { _subscribers: subscribers, _running: AbortOnDropHandle::new(running) })
    }
}

/// Executes the newest puts, one of each client at a time.
async fn run(newest: Arc<NewestPuts>, context: Context, gripper: Name) {
    let mut running = FuturesUnordered::new();
    let mut busy = HashSet::new();
    loop {
        for (client, put) in newest.take_except(&busy) {
            busy.insert(client.clone());
            running.push(execute(put, &context, &gripper).map(move |()| client));
        }
        tokio::select! {
            () = newest.added.notified() => {}
            Some(client) = running.next() => { busy.remove(&client); }
        }
    }
}

async fn execute(put: Put, context: &Context, gripper: &Name) {
    let Put { operation, fields } = put;
    let (caller, params) = request(&context.gateway, fields, gripper);
    let result = operations::call(&context.gateway, caller, Method::from(operation), Value::Object(params)).await;
    let status = result.map_or_else(|problem| problem.status().as_u16(), |_| 200);
    context.metrics.answered(Some(operation.name), "PUT", status);
}

/// The caller and the parameters of a put. `client` and `token` stand beside the parameters.
fn request(gateway: &Gateway, mut fields: Map<String, Value>, gripper: &Name) -> (Caller, Map<String, Value>) {
    let name = text_of(&mut fields, CLIENT).and_then(|name| ShownName::<MAX_CLIENT_BYTES>::new(&name).ok());
    let credential = text_of(&mut fields, TOKEN).map_or(Credential::None, |token| Credential::of_token(&token));
    let identity = identity(&gateway.access, &credential);
    let known = identity.as_ref().ok().and_then(|identity| identity.name.as_ref());
    let client = known.map_or_else(|| client(name.as_ref()), |name| Client::new(name.as_str(), Door::Zenoh));
    fields.insert(GRIPPER.to_owned(), gripper.as_str().into());
    (Caller::new(client, identity), fields)
}

fn text_of(fields: &mut Map<String, Value>, key: &str) -> Option<String> {
    match fields.remove(key) {
        Some(Value::String(text)) => Some(text),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn put(client: &str, width_mm: u8) -> Put {
        let Value::Object(fields) = json!({"client": client, "width_mm": width_mm}) else { unreachable!() };
        Put { operation: &servo::TARGET, fields }
    }

    fn widths(taken: &[(PutClient, Put)]) -> Vec<u64> {
        taken.iter().map(|(_, put)| put.fields["width_mm"].as_u64().unwrap()).collect()
    }

    #[test]
    fn newest_put_of_each_client_waits() {
        let puts = NewestPuts::default();
        assert!(puts.add(put("a", 1)) && puts.add(put("b", 2)) && puts.add(put("a", 3)));
        let busy = HashSet::from([client_of(&put("b", 0).fields)]);
        assert_eq!(widths(&puts.take_except(&busy)), [3]);
        assert_eq!(widths(&puts.take_except(&HashSet::new())), [2]);
    }

    #[test]
    fn waiting_and_executed_puts_are_bounded() {
        let puts = NewestPuts::default();
        let others: Vec<_> = (0..MAX_CLIENTS).map(|number| format!("client {number}")).collect();
        assert!(others.iter().all(|client| puts.add(put(client, 1))));
        assert!(!puts.add(put("one more", 2)) && puts.add(put(&others[0], 3)));
        let mut busy: HashSet<_> = (1..MAX_CLIENTS).map(|n| client_of(&put(&n.to_string(), 0).fields)).collect();
        assert_eq!(puts.take_except(&busy).len(), 1);
        busy.insert(client_of(&put("0", 0).fields));
        assert!(puts.take_except(&busy).is_empty());
    }
}
