//! A gateway that lets many clients share Weiss/SCHUNK WSG grippers safely.
//!
//! # The map
//!
//! | room | what it is for |
//! | --- | --- |
//! | [`wsg`] | the protocol, sans-IO: frames, commands, replies, and the [session](wsg::session) on a link |
//! | [`transport`] | byte pipes to devices; knows nothing of the protocol |
//! | [`gripper`] | one actor per gripper, the only owner of its state; everyone else has a [handle](gripper::Handle) |
//! | [`interfaces`] | [HTTP](interfaces::http), [Zenoh](interfaces::zenoh) and the [WSG port](interfaces::wsg_port) |
//! | [`operations`] | everything that a client may ask for, once |
//! | [`events`] | live updates, serialised once for all clients |
//! | [`fleet`] | the other gateways on the Zenoh network |
//! | [`interfaces::dashboard`] | the page at `/`, which uses the public WebSocket and REST alone |
//! | [`journal`] | events and grip records that outlive the gateway, in SQLite |
//! | [`sim`] | a device, modelled from the manual: a pure machine, with faults |
//! | [`config`] | file, environment and flags to validated types; nothing else reads them |
//! | [`daemon`] | the composition root: builds, connects, drains in order |
//! | [`cli`], [`logging`] | the command line, and logs |
//!
//! Data's way in: a door parses once and admits nothing; it hands a [`gripper::model`] value to the gripper's handle; the
//! [actor](gripper::actor) decides, and hands a request to the session; the session makes bytes. The way out: bytes,
//! session event, the actor's state, one watch of the newest state; [updates](events::Updates) are serialised once, and
//! their bytes shared by all clients. The device side runs on a runtime of its own, and so do WebSockets, so that no
//! number of clients delays a FAST STOP by much.
//!
//! # Invariants
//!
//! Each has a test by its name, on the frames that the device received: `frame_sent_at_most_once`,
//! `nothing_moves_unasked`, `fast_stop_overtakes`, `latch_blocks_motion`, `acknowledge_names_its_latch`,
//! `stale_lease_moves_nothing`, `every_command_ends_once`, `unknown_is_said`, `announce_before_close`,
//! `device_refusal_is_not_our_error`, `observers_never_block`, `bounded`.
//!
//! FAST STOP is not a safety function in the sense of ISO 13850.

pub mod cli;
pub mod config;
pub mod daemon;
pub mod events;
pub mod fleet;
pub mod gripper;
pub mod interfaces;
pub mod journal;
pub mod logging;
pub mod operations;
pub mod sim;
pub mod transport;
pub mod wsg;
