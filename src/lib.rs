//! A gateway that lets many clients share Weiss/SCHUNK WSG grippers safely.
//!
//! # Modules
//!
//! - [`wsg`]: the protocol without I/O (sans-IO): frames, commands, replies, and the [session](wsg::session) on a link.
//! - [`transport`]: byte pipes to devices; knows nothing of the protocol.
//! - [`model`]: values, events and refusals that all others share.
//! - [`gripper`]: one actor per gripper, the only owner of its state; everyone else has a [handle](gripper::Handle).
//! - [`operations`]: everything that a client can request, defined once for all interfaces.
//! - [`interfaces`]: [HTTP](interfaces::http), [WebSocket](interfaces::websocket), [Modbus TCP](interfaces::modbus),
//!   [MQTT](interfaces::mqtt), [Zenoh](interfaces::zenoh), the [WSG port](interfaces::wsg_port), and the [dashboard](interfaces::dashboard) at `/`,
//!   which uses only the public WebSocket and REST.
//! - [`connections`]: connections of clients, accepted, admitted and encrypted in one way for all interfaces.
//! - [`access`]: roles and credentials, and their check.
//! - [`events`]: live updates, serialised once for all clients.
//! - [`trends`]: the measured values of the last ten minutes.
//! - [`recipes`]: the values with which parts are gripped and released.
//! - [`alarms`]: conditions that a person must know about, until they are acknowledged.
//! - [`fleet`]: the other gateways on the Zenoh network.
//! - [`wear`]: use of the fingers, and drift of contact widths.
//! - [`journal`]: events and grip records that outlive the gateway, in SQLite.
//! - [`webhooks`]: the journal's events, as HTTP requests to other programs.
//! - [`sim`]: a simulated device, modelled from the manual, with faults.
//! - [`config`]: file, environment and flags, turned into validated types; nothing else reads them.
//! - [`daemon`]: the composition root, which builds, connects and drains everything in order.
//! - [`doctor`]: checks of an installation, and discovery of devices.
//! - [`cli`] and [`logging`]: the command line, and logs.
//!
//! A request comes in through an interface, which parses it once into a [`model`] value for the gripper's
//! handle. The [actor](gripper::actor) decides, and hands a request to the session, which makes bytes. On the way out,
//! bytes become session events, which change the actor's state; clients follow its newest value.
//! [Updates](events::LiveUpdates) are serialised once, and all clients share their bytes. The device side runs on a
//! runtime of its own, and so do WebSockets, so that even a great number of clients hardly delays a FAST STOP.
//!
//! # Invariants
//!
//! Each invariant has a test of the same name, which checks the frames that the device received:
//! `frame_sent_at_most_once`, `nothing_moves_unasked`, `fast_stop_overtakes`, `latch_blocks_motion`,
//! `acknowledge_names_its_latch`, `stale_lease_moves_nothing`, `every_command_ends_once`, `unknown_is_said`,
//! `announce_before_close`, `device_refusal_is_not_our_error`, `observers_never_block`, `bounded`.
//! `src/design.md` gives the meaning and the reason of each.
//!
//! FAST STOP is not a safety function in the sense of ISO 13850.

pub mod access;
pub mod alarms;
pub mod cli;
pub mod config;
pub mod connections;
pub mod daemon;
pub mod doctor;
pub mod events;
pub mod fleet;
#[cfg(any(test, fuzzing))]
pub mod fuzz;
pub mod interfaces;
pub mod journal;
pub mod logging;
pub mod operations;
pub mod recipes;
pub mod trends;
pub mod wear;
pub mod webhooks;

pub use gripper;
pub use model;
pub use settings;
pub use sim;
pub use transport;
pub use wsg;
