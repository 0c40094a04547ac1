//! What a gripper needs of whoever keeps its records. The journal does; tests can.

use tokio::sync::{oneshot, watch};

use super::model::{Event, GripRecord, Memory};

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

/// Whether records become durable.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Health {
    /// Why they don't; none while they do.
    pub failure: Option<String>,
    /// How many found no place since the start.
    pub lost: u64,
}
