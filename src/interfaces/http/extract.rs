//! What handlers take from a request besides its body. Every mistake in it is a [`Problem`].

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{ConnectInfo, FromRequestParts, RawPathParams};
use axum::http::request::Parts;
use axum::http::{Extensions, HeaderMap};
use utoipa::IntoParams;

use super::Context;
use super::errors::{Code, Problem};
use super::pace::RequestPace;
use super::parameters::Parameters;
use super::values::{integer, text};
use crate::gripper::handle::Using;
use crate::gripper::model::{Client, Command, CommandId, Door, LeaseToken, RequestId, Text};
use crate::gripper::{Handle, Rejection, Ticket};
use crate::interfaces::admission::{Class, ConnectionPermit};
use crate::wsg::{self, Finger};

/// How long a request may wait for a command's end. Proxies and clients give up after a minute.
pub const MAX_WAIT_MS: u64 = 60_000;

/// How long a request waits for its command if it doesn't say: longer than most motions.
pub const DEFAULT_WAIT_MS: u64 = 5_000;

/// Delay of a connection's next request after its wait was cut short.
const CUT_SHORT_DELAY: Duration = Duration::from_secs(1);

/// The most bytes of a lease token that are looked at; the gateway's own are shorter.
pub const MAX_LEASE_BYTES: usize = 64;

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "the document's words on what Gripper takes from the path")]
pub struct GripperPath {
    /// The gripper's name.
    #[param(min_length = 1, max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "left")]
    gripper: String,
}

/// The gripper that the path names, and who asks.
#[derive(Debug, Clone)]
pub struct Gripper {
    pub handle: Handle,
    pub client: Client,
    /// The lease's token, where it could be read: a FAST STOP asks for none, and must not fail for it.
    pub lease: Result<Option<LeaseToken>, Problem>,
    using: Option<Arc<Use>>,
    presence: Presence,
}

/// Whether it shows when a client is gone while its request is open.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Presence {
    /// The request ends with its client: while it is open, it keeps the lease.
    #[default]
    Seen,
    /// It does not: the request uses the lease when it comes and when it is answered, and the lease's time runs between.
    Unseen,
}

/// A request's use of a lease.
#[derive(Debug)]
enum Use {
    /// For as long as it is open.
    Kept { _using: Using },
    /// When it came, and when it is answered.
    AtBothEnds { _answered: Answered },
}

/// The time of a lease runs from the answer.
#[derive(Debug)]
struct Answered {
    handle: Handle,
    lease: LeaseToken,
}

impl Drop for Answered {
    fn drop(&mut self) {
        drop(self.handle.use_lease(self.lease.clone()));
    }
}

impl Gripper {
    /// Its name.
    pub fn name(&self) -> String {
        self.handle.name().to_string()
    }

    /// With the lease's token of the body, too.
    pub fn with_lease(self, body: Option<&str>) -> Result<Self, Problem> {
        let Keys { lease, .. } = Keys { lease: self.lease?, request_id: None }.or_body(None, body)?;
        let using = self.using.or_else(|| using(&self.handle, lease.as_ref(), self.presence));
        Ok(Self { lease: Ok(lease), using, ..self })
    }

    /// The lease's token, if there is one.
    pub fn token(&self) -> Option<LeaseToken> {
        self.lease.as_ref().ok().cloned().flatten()
    }

    /// One request to the device that moves nothing.
    pub async fn exchange(&self, command: wsg::Command) -> Result<wsg::Data, Rejection> {
        self.handle.exchange(command, self.client.clone(), self.token()).await
    }
}

impl FromRequestParts<Arc<Context>> for Gripper {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, context: &Arc<Context>) -> Result<Self, Problem> {
        let unknown = || Problem::not_found("gripper of this name");
        let name = path_parameter(parts, "gripper").await?.parse().map_err(|_| unknown())?;
        let handle = context.fleet.get(&name).ok_or_else(unknown)?.clone();
        let lease = Keys::of(&parts.headers).map(|keys| keys.lease);
        let presence = parts.extensions.get().copied().unwrap_or_default();
        let using = using(&handle, lease.as_ref().ok().and_then(Option::as_ref), presence);
        Ok(Self { handle, client: Asker::of(&parts.extensions).0, lease, using, presence })
    }
}

/// Each request with a lease's token uses that lease, whatever it asks for.
fn using(handle: &Handle, lease: Option<&LeaseToken>, presence: Presence) -> Option<Arc<Use>> {
    let lease = lease?.clone();
    let using = handle.use_lease(lease.clone());
    Some(Arc::new(match presence {
        Presence::Seen => Use::Kept { _using: using },
        Presence::Unseen => Use::AtBothEnds { _answered: Answered { handle: handle.clone(), lease } },
    }))
}

/// Who asks. Before there are credentials that is the peer's address.
#[derive(Debug, Clone)]
pub struct Asker(pub Client);

impl Asker {
    /// Of a request's extensions: another door says who it is.
    pub fn of(extensions: &Extensions) -> Self {
        extensions.get().cloned().map_or_else(|| Self::through(Door::Http, "http", extensions), Self)
    }

    /// Of a request's extensions, at a door of this name.
    pub fn through(door: Door, name: &str, extensions: &Extensions) -> Self {
        let subject = match extensions.get::<ConnectInfo<SocketAddr>>() {
            Some(ConnectInfo(peer)) => format!("{name}:{}", peer.ip().to_canonical()),
            None => format!("{name}:unknown"),
        };
        Self(Client { subject: subject.into(), door })
    }
}

impl FromRequestParts<Arc<Context>> for Asker {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &Arc<Context>) -> Result<Self, Problem> {
        Ok(Self::of(&parts.extensions))
    }
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "the document's words on what CommandOf takes from the path")]
pub struct CommandPath {
    /// The command's id, as its answer had it.
    #[param(example = "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f")]
    command: uuid::Uuid,
}

/// The command that the path names.
#[derive(Debug, Clone, Copy)]
pub struct CommandOf(pub CommandId);

impl FromRequestParts<Arc<Context>> for CommandOf {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &Arc<Context>) -> Result<Self, Problem> {
        let id = path_parameter(parts, "command").await?.parse();
        id.map(Self).map_err(|_| Problem::not_found("command of this id: ids are UUIDs"))
    }
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "the document's words on what FingerOf takes from the path")]
pub struct FingerPath {
    /// The finger: 1 or 2.
    #[param(minimum = 1, maximum = 2, example = 1)]
    finger: u8,
}

/// The finger that the path names.
#[derive(Debug, Clone, Copy)]
pub struct FingerOf(pub Finger);

impl FromRequestParts<Arc<Context>> for FingerOf {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &Arc<Context>) -> Result<Self, Problem> {
        match path_parameter(parts, "finger").await?.as_str() {
            "1" => Ok(Self(Finger::One)),
            "2" => Ok(Self(Finger::Two)),
            _ => Err(Problem::not_found("such finger: they are 1 and 2")),
        }
    }
}

/// A path's parameter. What isn't even text names nothing.
async fn path_parameter(parts: &mut Parts, name: &str) -> Result<String, Problem> {
    let unknown = |_| Problem::not_found("such path");
    let parameters = RawPathParams::from_request_parts(parts, &()).await.map_err(unknown)?;
    let found = parameters.iter().find(|(key, _)| *key == name).map(|(_, value)| value.to_owned());
    found.ok_or_else(|| Problem::not_found("such path"))
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "the document's words on what WaitMs takes from the query")]
pub struct WaitQuery {
    /// How long to wait for the command's end, in ms; 0 doesn't wait. 5000 by default.
    #[param(minimum = 0, maximum = 60000, default = 5000, example = 5000)]
    wait_ms: Option<u64>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "the document's words on what WaitMs takes from the query")]
pub struct NoWaitQuery {
    /// How long to wait for the command's end, in ms. 0 by default: it is told as it is.
    #[param(minimum = 0, maximum = 60000, default = 0, example = 5000)]
    wait_ms: Option<u64>,
}

/// How long to wait for a command's end: `wait_ms`, or else `DEFAULT`.
#[derive(Debug, Clone)]
pub struct WaitMs<const DEFAULT: u64> {
    limit: Duration,
    permit: Option<Arc<ConnectionPermit>>,
    pace: Option<Arc<RequestPace>>,
}

impl<const DEFAULT: u64> WaitMs<DEFAULT> {
    /// The command when it has ended, or as it is after the wait. The wait is cut short where more requests wait than the
    /// gateway allows, or where this client has more than its share of them: the answer is the same as after `wait_ms`.
    pub async fn until_ended(&self, ticket: &mut Ticket) -> Command {
        let Some(permit) = self.permit.as_ref().filter(|_| !self.limit.is_zero()) else {
            return ticket.wait(self.limit).await;
        };
        if let Some(claim) = permit.claim(Class::Waiting) {
            tokio::select! {
                biased;
                command = ticket.wait(self.limit) => return command,
                () = claim.yielded() => {}
            }
        }
        permit.demote();
        // A client that repeats its request at once would take the time that others need.
        if let Some(pace) = &self.pace {
            pace.delay(CUT_SHORT_DELAY);
        }
        ticket.now()
    }
}

impl<const DEFAULT: u64> FromRequestParts<Arc<Context>> for WaitMs<DEFAULT> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &Arc<Context>) -> Result<Self, Problem> {
        let given = Parameters::of(&parts.uri)?.parsed("wait_ms", "a number of ms", |text| text.parse::<f64>().ok())?;
        let wait_ms = match given {
            Some(number) => integer("wait_ms", number, 0..=MAX_WAIT_MS)?,
            None => DEFAULT,
        };
        let (permit, pace) = (parts.extensions.get().cloned(), parts.extensions.get().cloned());
        Ok(Self { limit: Duration::from_millis(wait_ms), permit, pace })
    }
}

#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "the document's words on what Gripper takes from the headers")]
pub struct LeaseHeader {
    /// The lease's token, while somebody holds one. While the request is open, the lease doesn't run out.
    #[param(rename = "Wsg-Lease", nullable = false, max_length = 64, pattern = "^([!-~]([ -~]*[!-~])?)?$")]
    wsg_lease: Option<String>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "the document's words on what Keys takes from the headers")]
pub struct KeyHeaders {
    /// The same as `request_id` in the body, for clients that have it as a header.
    #[param(rename = "Idempotency-Key", nullable = false, max_length = 64, pattern = "^([!-~]([ -~]*[!-~])?)?$")]
    idempotency_key: Option<String>,
    /// The same as `lease` in the body.
    #[param(rename = "Wsg-Lease", nullable = false, max_length = 64, pattern = "^([!-~]([ -~]*[!-~])?)?$")]
    wsg_lease: Option<String>,
}

/// What makes a request repeatable, and what entitles to it: from the headers, or from the body.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Keys {
    pub request_id: Option<RequestId>,
    pub lease: Option<LeaseToken>,
}

impl Keys {
    /// Those of the headers.
    fn of(headers: &HeaderMap) -> Result<Self, Problem> {
        let lease = header::<MAX_LEASE_BYTES>(headers, "Wsg-Lease")?;
        Ok(Self { request_id: header(headers, "Idempotency-Key")?, lease: lease.map(|lease| lease.as_str().into()) })
    }

    /// Those of the body, too. An empty one is none: clients with fixed fields send that.
    pub fn or_body(self, request_id: Option<&str>, lease: Option<&str>) -> Result<Self, Problem> {
        let given = |text: &&str| !text.is_empty();
        let request_id = request_id.filter(given).map(|given| text("request_id", given)).transpose()?;
        let lease = lease.filter(given).map(|given| text::<MAX_LEASE_BYTES>("lease", given)).transpose()?;
        Ok(Self {
            request_id: one_of("request_id", self.request_id, request_id)?,
            lease: one_of("lease", self.lease, lease.map(|lease| lease.as_str().into()))?,
        })
    }
}

/// What was said in two places, if it is the same.
fn one_of<T: PartialEq>(field: &str, header: Option<T>, body: Option<T>) -> Result<Option<T>, Problem> {
    match (header, body) {
        (Some(header), Some(body)) if header != body => {
            Err(Problem::malformed(field, format!("{field} is given in a header and in the body, and differs")))
        }
        (header, body) => Ok(header.or(body)),
    }
}

impl FromRequestParts<Arc<Context>> for Keys {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &Arc<Context>) -> Result<Self, Problem> {
        Self::of(&parts.headers)
    }
}

fn header<const MAX: usize>(headers: &HeaderMap, name: &'static str) -> Result<Option<Text<MAX>>, Problem> {
    let mut values = headers.get_all(name).iter();
    let (first, None) = (values.next(), values.next()) else {
        return Err(Problem::malformed(name, format!("{name} is given more than once")));
    };
    let Some(value) = first.filter(|value| !value.is_empty()) else { return Ok(None) };
    let given = std::str::from_utf8(value.as_bytes())
        .map_err(|_| Problem::new(Code::Malformed, format!("{name} is no text")).field(name))?;
    text(name, given).map(Some)
}

#[cfg(test)]
#[path = "extract_tests.rs"]
mod tests;
