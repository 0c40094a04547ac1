//! Asking another gateway: one of its operations on one of its grippers, and its answer as it is.

use std::time::Duration;

use serde::Deserialize;
use serde_json::Value;
use serde_json::value::RawValue;
use zenoh::Wait as _;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::qos::Priority;
use zenoh::query::{QueryTarget, Reply};
use zenoh::sample::Locality;

use super::Network;
use super::keys::{self, Keys};
use crate::gripper::model::{Client, Name};

/// How long an answer may take on its way, beside what its operation may take.
const ON_ITS_WAY: Duration = Duration::from_secs(5);

/// What is asked.
#[derive(Debug)]
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
    /// Whether it goes before all else.
    pub is_urgent: bool,
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

impl Network {
    /// Asks the gateway that owns a gripper, and waits for its answer.
    ///
    /// # Errors
    /// [`NoAnswer`], which says whether anything was sent.
    pub async fn ask(&self, ask: Ask) -> Result<Asked, NoAnswer> {
        let session = self.session.get().cloned().ok_or(NoAnswer::Unknown)?;
        match self.others().is_alive(&ask.gateway) {
            None => return Err(NoAnswer::Unknown),
            Some(false) => return Err(NoAnswer::Gone),
            Some(true) => {}
        }
        let place = match self.asks.clone().try_acquire_owned() {
            Ok(place) => Some(place),
            Err(_) if ask.is_urgent => None,
            Err(_) => return Err(NoAnswer::TooMany),
        };
        let key = Keys::of(&ask.gateway).gripper(&ask.gripper, &format!("command/{}", ask.method));
        let subject = ("client", format!("{}/{}", self.gateway, ask.client.subject));
        let wait_ms = ask.wait.map(|wait| ("wait_ms", wait.as_millis().to_string()));
        let parameters = [subject].into_iter().chain(wait_ms).chain(ask.aside);
        let parameters: Vec<_> = parameters.map(|(key, value)| format!("{key}={}", keys::encoded(&value))).collect();
        let timeout = ask.wait.unwrap_or_default() + ON_ITS_WAY;
        let (payload, is_urgent) = (ask.params.to_string(), ask.is_urgent);
        // It may wait for a place, and nobody else does there.
        let sent = tokio::task::spawn_blocking(move || {
            let get = session.get(format!("{key}?{}", parameters.join(";"))).payload(payload).timeout(timeout);
            let get = get.encoding(Encoding::APPLICATION_JSON).allowed_destination(Locality::Remote);
            let get = get.target(QueryTarget::All).express(is_urgent);
            get.priority(if is_urgent { Priority::RealTime } else { Priority::DataHigh }).wait()
        });
        let replies = sent.await.ok().and_then(Result::ok).ok_or(NoAnswer::None)?;
        let reply = replies.recv_async().await.map_err(|_| NoAnswer::None)?;
        drop(place);
        told(&reply).ok_or(NoAnswer::None)
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
