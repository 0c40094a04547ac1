//! The interface to the recorder of a gripper: the journal, or a test.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use tokio::sync::{oneshot, watch};

use model::{CommandReport, Event, GripRecord, Parameters, PersistedState, RequestId};

/// Stores records without ever blocking a gripper. Records that do not fit into its buffer are lost, counted and
/// reported.
pub trait Recorder: Send + Sync + 'static {
    /// Accepts a record; records keep their order.
    fn record(&self, record: Record);

    fn health(&self) -> watch::Receiver<JournalHealth>;
}

#[derive(Debug)]
pub enum Record {
    /// An event, with a channel to signal that it is durable. The channel closes without a signal if that fails or
    /// takes too long.
    Event(Event, Option<oneshot::Sender<()>>),
    /// Measurements of a motion.
    Grip(Box<GripRecord>),
    /// State that outlives a restart.
    Persisted(PersistedState),
}

/// State of a gripper from an earlier run.
#[derive(Debug, Clone, Default)]
pub struct RestoredState {
    /// Value of [`PersistedKey::Settings`](model::PersistedKey::Settings).
    pub settings: Option<String>,
    /// Value of [`PersistedKey::Latch`](model::PersistedKey::Latch).
    pub latch: Option<String>,
    /// Value of [`PersistedKey::Lease`](model::PersistedKey::Lease).
    pub lease: Option<String>,
    /// Value of [`PersistedKey::Holding`](model::PersistedKey::Holding).
    pub holding: Option<String>,
    /// Value of [`PersistedKey::LastCommand`](model::PersistedKey::LastCommand).
    pub last_command: Option<String>,
    /// Requests with request ids, oldest first, so that a repetition moves nothing again.
    pub requests: Vec<PastRequest>,
    /// The time of which the journal has no records, if it was restored from a copy.
    pub unknown_past: Option<Arc<UnknownPast>>,
    /// Whether that run did not shut down cleanly: no disconnect was announced, and its last records may be missing.
    pub unclean: bool,
}

/// A request of an earlier run with a request id, and its command.
#[derive(Debug, Clone, PartialEq)]
pub struct PastRequest {
    pub request_id: RequestId,
    /// Parameters of the request, besides the command's kind.
    pub parameters: Parameters,
    /// Command of the request, which has ended.
    pub command: CommandReport,
}

/// The time of which a journal has no records because it was restored from a copy. Requests of that time may have been
/// executed, so their request ids cannot be recognised: until they are no longer valid, or a
/// person confirms that no client repeats its requests.
#[derive(Debug)]
pub struct UnknownPast {
    cause: String,
    until: Instant,
    confirmed: AtomicBool,
}

impl UnknownPast {
    /// `cause` is the difference that showed the restored journal.
    #[must_use]
    pub fn new(cause: String, until: Instant) -> Self {
        Self { cause, until, confirmed: AtomicBool::new(false) }
    }

    /// Whether an unknown request id may belong to a request that was executed.
    #[must_use]
    pub fn refuses_ids(&self, now: Instant) -> bool {
        now < self.until && !self.is_confirmed()
    }

    /// Whether a person knows of it.
    #[must_use]
    pub fn is_confirmed(&self) -> bool {
        self.confirmed.load(Ordering::Acquire)
    }

    pub fn confirm(&self) {
        self.confirmed.store(true, Ordering::Release);
    }

    #[must_use]
    pub fn cause(&self) -> &str {
        &self.cause
    }
}

/// Whether records become durable.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct JournalHealth {
    /// Reason that records do not become durable; `None` while they do.
    pub failure: Option<String>,
    /// Number of records lost since the start.
    pub lost: u64,
    /// Damage found in earlier records. New records still become durable.
    pub damage: Option<String>,
    /// How the journal differs from that of the last run, until a person confirms it.
    pub restored: Option<String>,
    /// Why the wall clock is doubtful, so that no record is removed for its age.
    pub clock: Option<String>,
}

/// Recorder that stores nothing: each record counts as durable at once.
#[derive(Debug, Clone, Copy, Default)]
pub struct NullRecorder;

impl Recorder for NullRecorder {
    fn record(&self, record: Record) {
        if let Record::Event(_, Some(durable)) = record {
            // The receiver may be gone.
            let _ = durable.send(());
        }
    }

    fn health(&self) -> watch::Receiver<JournalHealth> {
        watch::channel(JournalHealth::default()).1
    }
}
