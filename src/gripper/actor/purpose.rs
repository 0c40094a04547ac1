//! What a request in flight is for.

use tokio::sync::oneshot;

use super::super::error::Rejection;
use super::super::handle::Answer;
use super::super::model::{Client, CommandId};
use crate::wsg::{Command, Data, Force};

/// Purpose of a request in flight.
#[derive(Debug)]
pub(super) enum Purpose {
    Setup,
    Upkeep,
    FastStop,
    Acknowledge,
    /// Set Force Limit, before a grip.
    Force(CommandId, Force),
    Motion(CommandId),
    /// For a client's stop command, or on the gateway's own account.
    Stop(Option<CommandId>),
    Exchange(Exchange),
    /// A getter that several clients may wait for.
    Read(u8),
    Announce,
}

/// A client's request that moves nothing, under way.
#[derive(Debug)]
pub(super) struct Exchange {
    pub command: Command,
    pub answer: Answer<Data>,
    /// Told when the device has accepted the request.
    pub accepted: Option<oneshot::Sender<()>>,
    /// The setter whose value is being read back.
    pub setter: Option<Command>,
    pub client: Client,
}

/// Why the session did not take a request, and the request's purpose.
pub(super) type NotSubmitted = Box<(Rejection, Purpose)>;
