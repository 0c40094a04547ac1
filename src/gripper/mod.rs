//! Grippers: one actor per gripper, the only owner of its state; everyone else has a [`Handle`].
//!
//! [`model`] and [`info`] are the vocabulary of requests and answers, [`error`] says why a request was not done.

pub mod error;
pub mod fleet;
pub mod handle;
pub mod info;
pub mod model;

pub use error::{Conflict, DeviceRefusal, Failure, Invalid, Rejection};
pub use fleet::Fleet;
pub use handle::{FastStop, Handle, Ticket};
pub use info::Info;
