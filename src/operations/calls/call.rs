//! A request for an operation: its caller, its parameters, and the gripper that they name.

use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::sync::Arc;

use bytes::Bytes;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::caller::{Caller, CommandWait, Presence, RequestKeys};
use super::rights::require;
use crate::access::Right;
use crate::gripper::handle::Using;
use crate::gripper::{Handle, Rejection};
use crate::model::{Client, CommandId, LeaseToken, Name, PartId};
use crate::operations::gateway::Gateway;
use crate::operations::parameters::json;
use crate::operations::parameters::values::{LeaseField, part_id};
use crate::operations::problem::Problem;
use crate::recipes::ExpectedVersion;
use crate::webhooks::Webhook;
use crate::wsg::{self, Finger};

/// Path parameter that names a part.
pub const PART_ID: &str = "part_id";

/// The parameters of a request.
#[derive(Debug, Default)]
pub struct Params {
    /// Parameters that the operation's path names.
    pub path: BTreeMap<&'static str, String>,
    /// All other parameters.
    pub fields: Fields,
    /// Version of a recipe that the request expects, if that came alongside the parameters.
    pub expected: ExpectedVersion,
}

/// Parameters in the form that an interface received.
#[derive(Debug)]
pub enum Fields {
    /// The text of a JSON object; an empty text stands for an empty object.
    Text(Bytes),
    /// A JSON object without duplicate keys.
    Object(Map<String, Value>),
}

impl Default for Fields {
    fn default() -> Self {
        Self::Text(Bytes::new())
    }
}

/// A request for an operation whose parameters besides those in the path are a `P`.
#[derive(Debug)]
pub struct Call<P = NoFields> {
    pub gateway: Arc<Gateway>,
    pub caller: Caller,
    pub params: Params,
    fields: PhantomData<fn() -> P>,
}

/// Parameters of an operation that takes only a lease token.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({}))]
pub struct Leased {
    pub lease: Option<LeaseField>,
}

/// Parameters of an operation without any.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NoFields {}

impl Params {
    /// Returns the gripper's name, if the parameters have a valid one.
    pub fn gripper(&self) -> Option<Name> {
        self.path.get("gripper")?.parse().ok()
    }

    fn part(&self, key: &str) -> Result<&str, Problem> {
        self.path.get(key).map(String::as_str).ok_or_else(|| Problem::not_found("such path"))
    }
}

impl<P> Call<P> {
    pub(in crate::operations) fn new(gateway: Arc<Gateway>, caller: Caller, params: Params) -> Self {
        Self { gateway, caller, params, fields: PhantomData }
    }

    /// Returns the same request for a function with other parameters.
    pub(in crate::operations) fn with_fields<Q>(self) -> Call<Q> {
        Call::new(self.gateway, self.caller, self.params)
    }

    /// Returns the gripper, and uses the lease whose token came alongside the parameters.
    pub fn gripper(&self) -> Result<Gripper, Problem> {
        self.gripper_despite_mistakes()?.with_lease(None)
    }

    /// Returns the gripper, and uses the lease whose token came alongside the parameters, if that is valid.
    pub fn gripper_despite_mistakes(&self) -> Result<Gripper, Problem> {
        let text = self.params.part("gripper")?;
        let name: Name = text.parse().map_err(|_| self.no_gripper(text))?;
        let handle = self.gateway.grippers.get(&name).ok_or_else(|| self.no_gripper(text))?;
        let Caller { client, lease, request_id, presence, .. } = self.caller.clone();
        // Operations that need no request id refuse an invalid one, too.
        let lease = lease.and_then(|lease| request_id.map(|_| lease));
        let keeps_lease = self.may_operate(&name);
        let token = lease.as_ref().ok().and_then(Option::as_ref).filter(|_| keeps_lease);
        let used = token.map(|lease| LeaseUse::begin(&handle, lease, presence));
        Ok(Gripper { handle, client, lease, used, keeps_lease, presence })
    }

    /// Reports that no gripper has the name in the path.
    fn no_gripper(&self, name: &str) -> Problem {
        self.gateway.no_gripper(name, self.caller.identity.is_ok())
    }

    /// Whether the caller may still move the gripper.
    fn may_operate(&self, gripper: &Name) -> bool {
        self.caller.identity.as_ref().is_ok_and(|identity| identity.may(Right::Operate, Some(gripper)))
    }

    /// Checks that the caller has a further right.
    pub fn require(&self, right: Right) -> Result<(), Problem> {
        require(self.caller.identity.as_ref().map_err(|unknown| *unknown)?, right, self.params.gripper().as_ref())
    }

    /// Returns a text parameter, or `None` if the parameters cannot be parsed.
    pub fn lenient_text(&self, key: &str) -> Option<String> {
        match &self.params.fields {
            Fields::Text(text) => json::text_member(text, key),
            Fields::Object(object) => object.get(key)?.as_str().map(ToOwned::to_owned),
        }
    }

    /// Returns the keys that came alongside the parameters.
    pub fn keys(&self) -> Result<RequestKeys, Problem> {
        RequestKeys::of(&self.caller)
    }

    /// Returns how long the caller waits for a command.
    pub fn wait(&self, default_ms: u64) -> Result<CommandWait, Problem> {
        self.caller.wait.parse(default_ms)
    }

    /// Returns the command that the path names.
    pub fn command_id(&self) -> Result<CommandId, Problem> {
        self.params.part("command")?.parse().map_err(|_| Problem::not_found("command with this id: ids are UUIDs"))
    }

    /// Returns the part that the path names.
    pub fn part_id(&self) -> Result<PartId, Problem> {
        part_id(PART_ID, self.params.part(PART_ID)?)
    }

    /// Returns the webhook that the path names.
    pub fn webhook(&self) -> Result<Arc<Webhook>, Problem> {
        let found = self.gateway.webhooks.find(self.params.part("webhook")?);
        found.ok_or_else(|| Problem::not_found("webhook with this name"))
    }

    /// Returns the finger that the path names.
    pub fn finger(&self) -> Result<Finger, Problem> {
        match self.params.part("finger")? {
            "1" => Ok(Finger::One),
            "2" => Ok(Finger::Two),
            _ => Err(Problem::not_found("such finger: use 1 or 2").field("finger")),
        }
    }
}

impl<P: DeserializeOwned> Call<P> {
    /// Parses the parameters that the path does not name.
    pub fn fields(&self) -> Result<P, Problem> {
        match &self.params.fields {
            Fields::Text(text) => json::parse(text),
            Fields::Object(object) => json::of_object(object),
        }
    }

    /// Returns the gripper and the parameters. A lease token among them counts only after [`Gripper::with_lease`].
    pub fn gripper_and_fields(&self) -> Result<(Gripper, P), Problem> {
        Ok((self.gripper()?, self.fields()?))
    }
}

impl Call<Leased> {
    /// Returns the gripper of a request with no parameters but a lease token.
    pub fn leased(&self) -> Result<Gripper, Problem> {
        let (gripper, Leased { lease }) = self.gripper_and_fields()?;
        gripper.with_lease(lease.as_deref())
    }
}

/// A gripper with the client and the lease of a request.
#[derive(Debug)]
pub struct Gripper {
    pub handle: Handle,
    pub client: Client,
    lease: Result<Option<LeaseToken>, Problem>,
    used: Option<LeaseUse>,
    /// Whether the client's requests keep its lease, which needs the right to move the gripper.
    pub keeps_lease: bool,
    presence: Presence,
}

/// A request's use of a lease.
#[derive(Debug)]
enum LeaseUse {
    /// Uses the lease for as long as the request is open.
    WhileOpen { _open: Using },
    /// Uses the lease when the request arrives, and again when it is answered.
    AtBothEnds { _renewal: RenewalAtEnd },
}

/// Renews a lease when it is dropped.
#[derive(Debug)]
struct RenewalAtEnd {
    handle: Handle,
    lease: LeaseToken,
}

impl Drop for RenewalAtEnd {
    fn drop(&mut self) {
        drop(self.handle.use_lease(self.lease.clone()));
    }
}

impl LeaseUse {
    fn begin(handle: &Handle, lease: &LeaseToken, presence: Presence) -> Self {
        let open = handle.use_lease(lease.clone());
        match presence {
            Presence::Seen => Self::WhileOpen { _open: open },
            Presence::Unseen => {
                Self::AtBothEnds { _renewal: RenewalAtEnd { handle: handle.clone(), lease: lease.clone() } }
            }
        }
    }
}

impl Gripper {
    pub fn name(&self) -> String {
        self.handle.name().to_string()
    }

    /// Adds the lease token among the parameters, and uses that lease.
    pub fn with_lease(self, field: Option<&str>) -> Result<Self, Problem> {
        let RequestKeys { lease, .. } = RequestKeys { lease: self.lease?, request_id: None }.or_fields(None, field)?;
        let token = lease.as_ref().filter(|_| self.keeps_lease);
        let used = self.used.or_else(|| token.map(|lease| LeaseUse::begin(&self.handle, lease, self.presence)));
        Ok(Self { lease: Ok(lease), used, ..self })
    }

    /// Returns the lease token, if there is a valid one and its holder may still move the gripper.
    pub fn token(&self) -> Option<LeaseToken> {
        self.lease.as_ref().ok().cloned().flatten().filter(|_| self.keeps_lease)
    }

    /// Sends the device one request that moves nothing.
    pub async fn exchange(&self, command: wsg::Command) -> Result<wsg::Data, Rejection> {
        self.handle.exchange(command, self.client.clone(), self.token()).await
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use serde_json::json;

    use super::*;
    use crate::access::{Identity, Role};
    use crate::gripper::fake::{self, FakeScript, Fate};
    use crate::model::{Client, Door};
    use crate::operations::gripper::fast_stop;
    use crate::operations::{Code, Method, Wait, call};

    #[tokio::test(start_paused = true)]
    async fn open_request_keeps_the_lease_only_if_its_client_is_seen() {
        let gateway = Gateway::of([fake::gripper("left", FakeScript { fate: Fate::Runs, ..FakeScript::default() }).0]);
        let caller = Caller::new(Client::new("test", Door::Zenoh), Ok(Identity::anyone()));
        let ask = async |caller: &Caller, name: &str, fields: Value| -> Value {
            let mut params = json!({"gripper": "left"});
            params.as_object_mut().unwrap().extend(fields.as_object().unwrap().clone());
            let reply = call(&gateway, caller.clone(), Method::named(name).unwrap(), params).await.unwrap();
            serde_json::from_str(reply.body.get()).unwrap()
        };
        let token = ask(&caller, "lease.take", json!({"ttl_ms": 60_000})).await["token"].clone();
        let motion = json!({"width_mm": 50, "speed_mm_s": 50, "lease": token});
        let command = ask(&caller, "move", motion).await["id"].clone();
        let left = async || ask(&caller, "lease", json!({})).await["expires_in_ms"].as_u64().unwrap();
        for (presence, left_while_open_ms) in [(Presence::Seen, 60_000), (Presence::Unseen, 55_000)] {
            let lease = Ok(token.as_str().map(LeaseToken::from));
            let wait = Wait::Ms { given: Some("10000".to_owned()), limiter: None };
            let waiting = Caller { lease, presence, wait, ..caller.clone() };
            let look = async {
                tokio::time::sleep(Duration::from_secs(5)).await;
                left().await
            };
            let (_, left_while_open) = tokio::join!(ask(&waiting, "command", json!({"command": command})), look);
            assert!(left_while_open.abs_diff(left_while_open_ms) < 500, "{presence:?}: {left_while_open}");
            let left_then = left().await;
            assert!(left_then > 59_500, "{presence:?}: {left_then}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn lease_is_not_kept_without_the_right_to_move() {
        let limit = |_: &wsg::Command| Ok(wsg::Data::ForceLimit(wsg::Force::new(40.0).unwrap()));
        let script = FakeScript { exchange: limit, ..FakeScript::default() };
        let gateway = Gateway::of([fake::gripper("left", script).0]);
        let caller = Caller::new(Client::new("test", Door::Http), Ok(Identity::anyone()));
        let ask = async |caller: &Caller, name: &str| -> Value {
            let method = Method::named(name).unwrap();
            let reply = call(&gateway, caller.clone(), method, json!({"gripper": "left"})).await.unwrap();
            serde_json::from_str(reply.body.get()).unwrap()
        };
        let token = ask(&caller, "lease.take").await["token"].as_str().map(LeaseToken::from);
        for (role, method, left_ms) in [
            (Role::Operator, "settings.force-limit", 3000),
            (Role::Observer, "settings.force-limit", 2000),
            (Role::Stop, "stop", 1000),
        ] {
            let identity = Identity { role, ..Identity::anyone() };
            let holder = Caller { lease: Ok(token.clone()), identity: Ok(identity), ..caller.clone() };
            ask(&holder, method).await;
            assert_eq!(ask(&caller, "lease").await["expires_in_ms"], left_ms, "{role:?}");
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }

    #[tokio::test]
    async fn invalid_request_id_is_refused_by_a_read() {
        let gateway = Gateway::of([fake::gripper("left", FakeScript::default()).0]);
        let client = Client::new("test", Door::Http);
        let request_id = Err(Problem::malformed("Idempotency-Key", "invalid"));
        let caller = Caller { request_id, ..Caller::new(client, Ok(Identity::anyone())) };
        for name in ["state", "settings.acceleration", "finger-set"] {
            let method = Method::named(name).unwrap();
            let refused = call(&gateway, caller.clone(), method, json!({"gripper": "left"})).await;
            assert_eq!(refused.unwrap_err().code(), Code::Malformed, "{name}");
        }
        assert!(call(&gateway, caller, (&fast_stop::ONE).into(), json!({"gripper": "left"})).await.is_ok());
    }
}
