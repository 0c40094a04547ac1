//! What a gripper needs of whoever keeps its records. The journal does; tests can.

use tokio::sync::{oneshot, watch};

use super::model::{Command, Event, GripRecord, Memory, Parameters, RequestId};

/// Keeps records. It never makes a gripper wait: what finds no place is counted and lost, and said to be.
pub trait Recorder: Send + Sync + 'static {
    /// Takes a record, in order.
    fn record(&self, record: Record);

    /// How the journal is.
    fn health(&self) -> watch::Receiver<Health>;
}

/// What is to be kept.
#[derive(Debug)]
pub enum Record {
    /// Something happened. Who waits until that is durable is told; by the channel's end where it will not be, or not
    /// soon.
    Event(Event, Option<oneshot::Sender<()>>),
    /// A motion's measurements.
    Grip(Box<GripRecord>),
    /// What has to outlive a restart.
    Memory(Memory),
}

/// What is known of a gripper from an earlier run.
#[derive(Debug, Clone, Default)]
pub struct Recollection {
    /// The value of [`MemoryKey::Settings`](super::model::MemoryKey::Settings).
    pub settings: Option<String>,
    /// The value of [`MemoryKey::Latch`](super::model::MemoryKey::Latch).
    pub latch: Option<String>,
    /// The value of [`MemoryKey::Lease`](super::model::MemoryKey::Lease).
    pub lease: Option<String>,
    /// The value of [`MemoryKey::Holding`](super::model::MemoryKey::Holding).
    pub holding: Option<String>,
    /// The requests with ids of their own, so that a repetition moves nothing again: the oldest first.
    pub requests: Vec<PastRequest>,
    /// Whether that run has not ended in order, so that nothing was announced, and its last records may be missing.
    pub unclean: bool,
}

/// A request of an earlier run with an id of its own, and the command that it became.
#[derive(Debug, Clone, PartialEq)]
pub struct PastRequest {
    /// What makes a repetition the same request, for the same gripper and client.
    pub request_id: RequestId,
    /// What was asked for, beside the command's kind.
    pub parameters: Parameters,
    /// The command, which has ended.
    pub command: Command,
}

/// Whether records become durable.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Health {
    /// Why they don't; none while they do.
    pub failure: Option<String>,
    /// How many found no place since the start.
    pub lost: u64,
    /// Damage of earlier records, found since the start. It does not keep new records from becoming durable.
    pub damage: Option<String>,
}

/// A recorder for who needs none: what is recorded counts as durable at once, and is gone.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unrecorded;

impl Recorder for Unrecorded {
    fn record(&self, record: Record) {
        if let Record::Event(_, Some(durable)) = record {
            // Who waited may be gone.
            let _ = durable.send(());
        }
    }

    fn health(&self) -> watch::Receiver<Health> {
        watch::channel(Health::default()).1
    }
}
