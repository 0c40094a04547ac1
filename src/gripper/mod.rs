//! Grippers: one actor per gripper, the only owner of its state; everyone else has a [`Handle`].
//!
//! [`model`] and [`info`] are the vocabulary of requests and replies; [`model::error`] has the reasons for a rejected request.
//! The [`actor`] is a pure state machine that makes the decisions. The `driver` does its I/O over a link from a
//! [`Connector`].

pub mod actor;
mod automatic_updates;
mod connector;
mod curve;
mod driver;
#[cfg(any(test, feature = "testing"))]
pub mod fake;
pub mod grippers;
pub mod handle;
pub mod info;
mod last_command;
mod latch;
mod lease;
mod lease_terms;
pub mod limits;
pub mod metrics;
mod observed;
pub mod recorder;
mod registry;
mod request_ids;
mod servo;
mod setup;

pub use connector::Connector;
pub use driver::spawn;
pub use grippers::{GripperChanges, Grippers};
pub use handle::{AcquiredLease, FastStop, Handle, Reconfiguration, Ticket};
pub use info::Info;
pub use lease::LeaseKeepAlive;
pub use metrics::GripperMetrics;
pub use model::Now;
pub use model::error::{Conflict, DeviceRefusal, Failure, Invalid, MotionError, Rejection};
pub use recorder::{JournalHealth, NullRecorder, Record, Recorder};
