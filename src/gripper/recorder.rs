//! The interface to the keeper of a gripper's records: the journal, or a test.

use tokio::sync::{oneshot, watch};

use super::model::{Command, Event, GripRecord, Parameters, PersistedState, RequestId};

/// Keeps records. It never makes a gripper wait: what finds no place is counted and lost, and said to be.
pub trait Recorder: Send + Sync + 'static {
    /// Takes a record, in order.
    fn record(&self, record: Record);

    /// Health of the journal.
    fn health(&self) -> watch::Receiver<Health>;
}

/// A record to keep.
#[derive(Debug)]
pub enum Record {
    /// Something happened. Who waits until that is durable is told; by the channel's end where it will not be, or not
    /// soon.
    Event(Event, Option<oneshot::Sender<()>>),
    /// A motion's measurements.
    Grip(Box<GripRecord>),
    /// State that outlives a restart.
    Persisted(PersistedState),
}

/// State of a gripper from an earlier run.
#[derive(Debug, Clone, Default)]
pub struct RestoredState {
    /// The value of [`PersistedKey::Settings`](super::model::PersistedKey::Settings).
    pub settings: Option<String>,
    /// The value of [`PersistedKey::Latch`](super::model::PersistedKey::Latch).
    pub latch: Option<String>,
    /// The value of [`PersistedKey::Lease`](super::model::PersistedKey::Lease).
    pub lease: Option<String>,
    /// The value of [`PersistedKey::Holding`](super::model::PersistedKey::Holding).
    pub holding: Option<String>,
    /// The requests with ids of their own, so that a repetition moves nothing again: the oldest first.
    pub requests: Vec<PastRequest>,
    /// Whether that run has not ended in order, so that nothing was announced, and its last records may be missing.
    pub unclean: bool,
}

/// A request of an earlier run with an id of its own, and the command that it became.
#[derive(Debug, Clone, PartialEq)]
pub struct PastRequest {
    /// Id that makes a repetition the same request, for the same gripper and client.
    pub request_id: RequestId,
    /// Parameters of the request, beside the command's kind.
    pub parameters: Parameters,
    /// The command, which has ended.
    pub command: Command,
}

/// Whether records become durable.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Health {
    /// Cause of records that don't become durable; none while they do.
    pub failure: Option<String>,
    /// Records that found no place since the start.
    pub lost: u64,
    /// Damage of earlier records, found since the start. It does not keep new records from becoming durable.
    pub damage: Option<String>,
}

/// A recorder that keeps nothing: each record counts as durable at once.
#[derive(Debug, Clone, Copy, Default)]
pub struct NullRecorder;

impl Recorder for NullRecorder {
    fn record(&self, record: Record) {
        if let Record::Event(_, Some(durable)) = record {
            // The receiver may be gone.
            let _ = durable.send(());
        }
    }

    fn health(&self) -> watch::Receiver<Health> {
        watch::channel(Health::default()).1
    }
}
