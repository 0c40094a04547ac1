//! Targets of servo sessions via a put, which gets no answer. A newer one replaces one that waits.

use std::sync::Arc;

use serde_json::{Map, Value};
use tokio::sync::watch;
use tokio_util::task::AbortOnDropHandle;
use zenoh::pubsub::Subscriber;

use super::client::{client, identity};
use super::payloads::body;
use crate::access::Credential;
use crate::connections::metrics::InterfaceMetrics;
use crate::fleet::TOKEN;
use crate::fleet::keys::{MAX_CLIENT_BYTES, ZenohKeys};
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

/// The newest put.
#[derive(Debug, Clone)]
struct Put {
    operation: &'static Operation,
    payload: Vec<u8>,
}

impl ServoTargets {
    /// Subscribes to the keys of a gripper, on the caller's runtime.
    pub async fn declare(
        session: &zenoh::Session,
        keys: &ZenohKeys,
        gateway: &Arc<Gateway>,
        metrics: &InterfaceMetrics,
        gripper: &Name,
    ) -> zenoh::Result<Self> {
        let newest = watch::Sender::new(None);
        let running = tokio::spawn(run(newest.subscribe(), gateway.clone(), metrics.clone(), gripper.clone()));
        let mut subscribers = Vec::new();
        for operation in PUTS {
            let newest = newest.clone();
            let subscriber = session.declare_subscriber(keys.command(Some(gripper), operation.name));
            subscribers.push(
                subscriber
                    .callback(move |sample| {
                        let payload = sample.payload().to_bytes().into_owned();
                        newest.send_replace(Some(Put { operation, payload }));
                    })
                    .await?,
            );
        }
        Ok(Self { _subscribers: subscribers, _running: AbortOnDropHandle::new(running) })
    }
}

/// Executes the newest put, one at a time, until there can be no further one.
async fn run(
    mut newest: watch::Receiver<Option<Put>>,
    gateway: Arc<Gateway>,
    metrics: InterfaceMetrics,
    gripper: Name,
) {
    while newest.changed().await.is_ok() {
        let Some(Put { operation, payload }) = newest.borrow_and_update().clone() else { continue };
        let result = match body(&payload) {
            Ok(fields) => {
                let (caller, params) = request(&gateway, fields, &gripper);
                operations::call(&gateway, caller, Method::from(operation), Value::Object(params)).await
            }
            Err(problem) => Err(problem),
        };
        let status = result.map_or_else(|problem| problem.status().as_u16(), |_| 200);
        metrics.answered(Some(operation.name), "PUT", status);
    }
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
