//! The WSG binary command protocol, sans-IO: no runtime, no clock, no randomness. Inputs are bytes and `now`.
//!
//! [`frame`] and [`decoder`] are the outermost layer, [`command`] and [`reply`] give a frame its meaning, and
//! [`session`] is the state of one link: requests in flight, queued requests and late replies. Citations name a manual
//! (`fw2`, `fw4-de`, `fw4-en`) and its section; `src/rulings.md` lists the manuals. If manuals contradict each other, a
//! comment starts with "Ruling", and a `ruling_…` test enforces it.
//!
//! Architecture invariant: this crate depends on no other of this project.

#![warn(missing_docs)]

pub mod command;
pub mod crc;
pub mod decoder;
pub mod device;
pub mod frame;
#[cfg(any(test, fuzzing, feature = "fuzz"))]
pub mod fuzz;
pub mod id;
mod missed_fast_stop;
pub mod opening;
mod payload;
pub mod quantity;
pub mod reply;
pub mod session;
pub mod state;
pub mod status;
pub mod text;
pub mod timed_decoder;
pub mod updates;

pub use command::{
    Command, CustomCommand, HomingDirection, InvalidRequest, LoopData, MoveFlags, Updates, VerbatimCommand,
};
pub use decoder::{Decoded, Decoder, DecoderCounters};
pub use device::{
    DeviceTag, DeviceType, Finger, FingerFlags, FingerInfo, FingerType, Firmware, InvalidDeviceTag, SoftLimits,
    Statistics, SystemInfo, SystemLimits,
};
pub use frame::{ChecksumEvaluation, Frame};
pub use opening::Opening;
pub use quantity::{Acceleration, Force, NotFinite, Speed, Width};
pub use reply::{Data, InvalidReply, Reply, Temperature};
pub use state::{GripperState, SystemState};
pub use status::Status;
pub use timed_decoder::TimedDecoder;
pub use updates::Subscriptions;
