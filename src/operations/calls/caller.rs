//! The client behind a request, with the lease token, request id and wait that come alongside the parameters.

use std::sync::Arc;
use std::time::Duration;

use futures_util::future::BoxFuture;

use crate::access::{Identity, Unauthorized};
use crate::gripper::Ticket;
use crate::model::{Client, ClientLabel, CommandReport, LeaseToken, RequestId};
use crate::operations::parameters::values::{integer, text};
use crate::operations::problem::Problem;

/// Longest wait for a command's end, in ms. Proxies and clients give up after a minute.
pub const MAX_WAIT_MS: u64 = 60_000;

/// Default wait for a command's end, in ms: longer than most motions.
pub const DEFAULT_WAIT_MS: u64 = 5_000;

/// Longest accepted lease token, in bytes. The gateway's own tokens are shorter.
pub const MAX_LEASE_BYTES: usize = 64;

/// A client with one request.
#[derive(Debug, Clone)]
pub struct Caller {
    /// Name of the client, and the interface that it uses.
    pub client: Client,
    /// Rights of the client. A FAST STOP can be open to unknown clients.
    pub identity: Result<Identity, Unauthorized>,
    /// Lease token sent alongside the parameters. A FAST STOP needs none, and must not fail because of an invalid one.
    pub lease: Result<Option<LeaseToken>, Problem>,
    /// Request id sent alongside the parameters.
    pub request_id: Result<Option<RequestId>, Problem>,
    pub presence: Presence,
    /// How long the caller waits for the end of a command.
    pub wait: Wait,
}

/// Whether the interface notices that a client is gone while its request is open.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Presence {
    /// The request ends with its client: while it is open, it keeps the lease.
    #[default]
    Seen,
    /// The request does not end with its client: it renews the lease when it arrives and when it is answered.
    Unseen,
}

/// How long a caller waits for the end of a command.
#[derive(Debug, Clone)]
pub enum Wait {
    /// No wait: the reply comes as soon as the command is admitted.
    No,
    /// A wait as long as the request says, or else the operation's default.
    Ms {
        /// The request's `wait_ms`, unparsed.
        given: Option<String>,
        /// Cuts waits short while too many requests wait.
        limiter: Option<Arc<dyn WaitLimiter>>,
    },
}

/// A bound on waits that an interface sets.
pub trait WaitLimiter: std::fmt::Debug + Send + Sync {
    /// Returns the ended command. If `limit` passes or the wait is cut short first, returns the command in its current
    /// state.
    fn until_ended<'a>(&'a self, ticket: &'a mut Ticket, limit: Duration) -> BoxFuture<'a, CommandReport>;
}

/// A validated wait.
#[derive(Debug)]
pub struct CommandWait {
    limit: Duration,
    limiter: Option<Arc<dyn WaitLimiter>>,
}

impl Caller {
    /// Returns a caller without a lease or request id that waits for nothing. Its credential names the client, also if
    /// another person has entered a PIN since the connection began.
    #[must_use]
    pub fn new(client: Client, identity: Result<Identity, Unauthorized>) -> Self {
        let name = identity.as_ref().ok().and_then(|identity| identity.name.as_ref());
        let client = match name {
            Some(name) => Client::new(name.to_string(), client.door),
            None => client,
        };
        Self { client, identity, lease: Ok(None), request_id: Ok(None), presence: Presence::Seen, wait: Wait::No }
    }

    /// Adds the label that the client gave with the request, unless its credential names it. A label that is not
    /// allowed is ignored, since it must not keep a request from the device.
    #[must_use]
    pub fn labelled(mut self, given: Option<&str>) -> Self {
        let is_named = self.identity.as_ref().is_ok_and(|identity| identity.name.is_some());
        self.client.label = given.filter(|_| !is_named).and_then(ClientLabel::new);
        self
    }

    /// Leaves out an invalid lease, request id or wait, for a request that is executed in any case.
    #[must_use]
    pub fn without_mistakes(mut self) -> Self {
        self.lease = Ok(self.lease.unwrap_or_default());
        self.request_id = Ok(self.request_id.unwrap_or_default());
        if let Wait::Ms { given, .. } = &mut self.wait {
            given.take_if(|given| wait_ms(given).is_err());
        }
        self
    }
}

impl Wait {
    /// Parses the wait of a request for a command; `None` in `given` stands for `default_ms`.
    ///
    /// # Errors
    /// A problem if `wait_ms` is not a whole number from 0 to 60000.
    pub fn parse(&self, default_ms: u64) -> Result<CommandWait, Problem> {
        let Self::Ms { given, limiter } = self else {
            return Ok(CommandWait { limit: Duration::ZERO, limiter: None });
        };
        let wait_ms = given.as_deref().map(wait_ms).transpose()?.unwrap_or(default_ms);
        Ok(CommandWait { limit: Duration::from_millis(wait_ms), limiter: limiter.clone() })
    }
}

/// Parses `wait_ms`.
///
/// # Errors
/// A problem if the text is not a whole number from 0 to 60000.
pub fn wait_ms(given: &str) -> Result<u64, Problem> {
    let number: f64 = given.parse().map_err(|_| {
        Problem::malformed("wait_ms", "wait_ms must be a number of milliseconds").value(Some(given.into()))
    })?;
    integer("wait_ms", number, 0..=MAX_WAIT_MS)
}

impl CommandWait {
    /// Returns the ended command, or after the wait the command in its current state.
    pub async fn until_ended(&self, ticket: &mut Ticket) -> CommandReport {
        match &self.limiter {
            Some(limiter) if !self.limit.is_zero() => limiter.until_ended(ticket, self.limit).await,
            _ => ticket.wait(self.limit).await,
        }
    }
}

/// The request id, which makes a request safe to repeat, and the lease token, which authorises it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RequestKeys {
    pub request_id: Option<RequestId>,
    pub lease: Option<LeaseToken>,
}

impl RequestKeys {
    /// Returns the keys that came alongside the parameters.
    pub fn of(caller: &Caller) -> Result<Self, Problem> {
        Ok(Self { lease: caller.lease.clone()?, request_id: caller.request_id.clone()? })
    }

    /// Adds the keys among the parameters. An empty text means none: clients with fixed fields send it.
    pub fn or_fields(self, request_id: Option<&str>, lease: Option<&str>) -> Result<Self, Problem> {
        let request_id = request_id.filter(|given| !given.is_empty());
        let request_id = request_id.map(|given| text("request_id", given)).transpose()?;
        let lease = lease.filter(|given| !given.is_empty());
        let lease = lease.map(|given| text::<MAX_LEASE_BYTES>("lease", given)).transpose()?;
        Ok(Self {
            request_id: one_of("request_id", self.request_id, request_id)?,
            lease: one_of("lease", self.lease, lease.map(|lease| lease.as_str().into()))?,
        })
    }
}

/// Merges a value that a client can send in a header and in the body.
fn one_of<T: PartialEq>(field: &str, header: Option<T>, body: Option<T>) -> Result<Option<T>, Problem> {
    match (header, body) {
        (Some(header), Some(body)) if header != body => {
            Err(Problem::malformed(field, format!("{field} differs between the header and the body: send it once")))
        }
        (header, body) => Ok(header.or(body)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Door;

    fn limit(given: Option<&str>) -> Result<Duration, u16> {
        let wait = Wait::Ms { given: given.map(ToOwned::to_owned), limiter: None };
        wait.parse(DEFAULT_WAIT_MS).map(|wait| wait.limit).map_err(|problem| problem.status().as_u16())
    }

    #[test]
    fn wait_is_from_0_to_60000_ms() {
        assert_eq!(limit(None), Ok(Duration::from_secs(5)));
        assert_eq!(limit(Some("0")), Ok(Duration::ZERO));
        assert_eq!(limit(Some("96.0")), Ok(Duration::from_millis(96)));
        assert_eq!(limit(Some("60000")), Ok(Duration::from_mins(1)));
        for beyond in ["60001", "-1", "1e30"] {
            assert_eq!(limit(Some(beyond)), Err(422), "{beyond}");
        }
        for wrong in ["abc", "", "0.5", "NaN", "inf"] {
            assert_eq!(limit(Some(wrong)), Err(400), "{wrong}");
        }
        assert_eq!(Wait::No.parse(DEFAULT_WAIT_MS).unwrap().limit, Duration::ZERO);
    }

    #[test]
    fn only_clients_without_a_name_have_labels() {
        let caller = |name: Option<&str>| {
            let identity = Identity { name: name.map(|name| name.parse().unwrap()), ..Identity::anyone() };
            Caller::new(Client::new("ws:10.0.0.5", Door::Ws), Ok(identity))
        };
        let label = |caller: Caller| caller.labelled(Some("Anna")).client.label;
        assert_eq!(label(caller(None)), ClientLabel::new("Anna"));
        assert_eq!(label(caller(Some("plc7"))), None);
        let stranger = Caller::new(Client::new("ws:10.0.0.5", Door::Ws), Err(Unauthorized::Missing));
        assert_eq!(label(stranger), ClientLabel::new("Anna"));
        assert_eq!(caller(None).labelled(Some("\u{202E}annA")).client.label, None);
    }

    #[test]
    fn credential_names_the_client() {
        let name = Some("anna".parse().unwrap());
        let caller = Caller::new(Client::new("panel", Door::Ws), Ok(Identity { name, ..Identity::anyone() }));
        assert_eq!((&*caller.client.subject, caller.client.door), ("anna", Door::Ws));
        let unnamed = Caller::new(Client::new("ws:10.0.0.7", Door::Ws), Ok(Identity::anyone()));
        assert_eq!(&*unnamed.client.subject, "ws:10.0.0.7");
    }

    #[test]
    fn keys_come_from_headers_or_fields() {
        let keys = RequestKeys::default().or_fields(Some("job 7"), Some("token")).unwrap();
        assert_eq!(keys.clone().or_fields(Some("job 7"), None).unwrap(), keys);
        assert_eq!(keys.clone().or_fields(Some(""), Some("")).unwrap(), keys);
        assert_eq!(keys.or_fields(Some("job 8"), None).unwrap_err().status().as_u16(), 400);
        assert_eq!(RequestKeys::default().or_fields(Some(""), Some("")).unwrap(), RequestKeys::default());
        assert_eq!(RequestKeys::default().or_fields(Some("a\nb"), None).unwrap_err().status().as_u16(), 400);
    }
}
