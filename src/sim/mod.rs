//! A simulated WSG gripper, as the manuals describe it, for tests and for trials without a gripper.
//!
//! [`Device`] is a pure state machine that runs on any clock. Its inputs are bytes, [`Change`]s and `now`. After each
//! input, drain [`Device::poll_transmit`] until it returns `false`, then [`Device::poll_link`]. Call
//! [`Device::handle_timeout`] when [`Device::poll_timeout`] is due. Late calls do not change the result, because
//! motions always advance in steps of [`STEP`].
//!
//! Structure: `motion` builds motions from steps, of which each moves the fingers on their `axis` among the objects in
//! `world`; `process` keeps the gripper state and the statistics. `requests` handles requests by kind, and replies.
//! `link` receives and sends bytes, with faults. `timers` runs what is due. [`Change`] lists events from outside the
//! protocol, and [`FaultKind`] lists faults on the wire.
//!
//! Architecture invariant: no runtime, no clock, no randomness, and no imports from this crate except
//! [`wsg`].

use std::collections::VecDeque;
use std::time::Instant;

use wsg::{Subscriptions, TimedDecoder};

mod change;
mod config;
mod fingers;
mod link;
mod models;
mod motion;
mod options;
mod possible_changes;
mod process;
mod requests;
#[cfg(test)]
mod rulings_tests;
mod snapshot;
mod thermal;
mod timers;
#[cfg(test)]
mod updates_tests;

pub use change::Change;
pub use config::{BadChecksum, DeviceConfig, FingerConfig, Script, ScriptAnswer, SteeringConfig, SteeringScript};
pub use link::faults::{FaultCounts, FaultKind, FaultName, MAX_ARMED_FAULTS};
pub use link::outbox::{MAX_QUEUED_FRAMES, MAX_QUEUED_REPLIES};
pub use link::received::{MAX_RECEIVED_FRAMES, ReceivedFrame};
pub use link::{Interface, LinkAction};
pub use models::{Generation, Model};
pub use motion::axis::{AxisDirection, STEP};
pub use motion::world::{GripSide, Part};
pub use possible_changes::ImpossibleChange;
pub use requests::getters::BrokenGetter;
pub use snapshot::Snapshot;

use fingers::FingerPort;
use link::faults::Faults;
use link::outbox::ReplyQueue;
use link::received::ReceivedLog;
use motion::Mechanics;
use process::{MotionKind, Process};
use requests::device_settings::DeviceSettings;
use requests::getters::BrokenGetters;
use requests::replies::{Late, PendingReply};
use requests::steering::Steering;
use thermal::Thermal;

/// The running motion. The ticket for its result is `None` if no client requested it.
#[derive(Debug)]
struct Running {
    kind: MotionKind,
    ticket: Option<PendingReply>,
}

/// A simulated device.
#[derive(Debug)]
#[allow(clippy::struct_excessive_bools, reason = "independent states in any combination")]
pub struct Device {
    config: DeviceConfig,
    /// Newest time given by the caller.
    clock: Instant,
    next_step: Option<Instant>,
    booting_until: Option<Instant>,

    mechanics: Mechanics,
    process: Process,
    running: Option<Running>,
    /// Stops that wait for the fingers to come to rest.
    stops: Vec<PendingReply>,
    settings: DeviceSettings,
    fingers: [FingerPort; 2],
    /// Tickets for the results of powering up the fingers.
    finger_tickets: [Option<PendingReply>; 2],
    thermal: Thermal,
    sensor_offset_n: f64,

    fast_stopped: bool,
    overheated: bool,
    power_fault: bool,
    current_fault: bool,
    current_fault_clears_at: Option<Instant>,
    command_failed: bool,
    script_runs: bool,
    script_failed: bool,
    steering: Steering,

    link: Option<Interface>,
    /// Connection number. A reply for an earlier connection is dropped.
    connection: u64,
    announced: bool,
    is_cut: bool,
    half_open: bool,
    silent: bool,
    /// Silent because of a fault, until the next connection.
    muted: bool,
    refuses_connections: bool,
    link_actions: VecDeque<LinkAction>,
    decoder: TimedDecoder,
    outbox: ReplyQueue,
    /// Bytes that leave before the outbox's, one chunk per write.
    chunks: VecDeque<Vec<u8>>,
    late: Vec<Late>,
    subscriptions: Subscriptions,

    faults: Faults,
    broken_getters: BrokenGetters,
    log: ReceivedLog,
    damaged_requests: u64,
    refused_requests: u64,
}

impl Device {
    /// Creates a device that was just switched on.
    #[must_use]
    pub fn new(config: DeviceConfig, now: Instant) -> Self {
        let max_acceleration_mm_s2 = f64::from(config.limits.max_acceleration.mm_s2());
        let mut mechanics = Mechanics::new(config.start_width_mm, config.stroke_mm(), max_acceleration_mm_s2);
        if let Some(part) = config.part {
            mechanics.world.place_part(part, config.start_width_mm);
        }
        Self {
            clock: now,
            next_step: None,
            booting_until: None,
            mechanics,
            process: Process::new(config.is_fw4()),
            running: None,
            stops: Vec::new(),
            settings: DeviceSettings::new(&config),
            fingers: config.fingers.clone().map(FingerPort::new),
            finger_tickets: [None, None],
            thermal: Thermal::new(config.ambient_c, now),
            sensor_offset_n: config.force_sensor_offset_n,
            fast_stopped: false,
            overheated: false,
            power_fault: false,
            current_fault: false,
            current_fault_clears_at: None,
            command_failed: false,
            script_runs: config.has_script(),
            script_failed: false,
            steering: Steering::new(now),
            link: None,
            connection: 0,
            announced: false,
            is_cut: false,
            half_open: false,
            silent: false,
            muted: false,
            refuses_connections: false,
            link_actions: VecDeque::new(),
            decoder: link::request_decoder(&config),
            outbox: ReplyQueue::default(),
            chunks: VecDeque::new(),
            late: Vec::new(),
            subscriptions: Subscriptions::default(),
            faults: Faults::default(),
            broken_getters: BrokenGetters::default(),
            log: ReceivedLog::default(),
            damaged_requests: 0,
            refused_requests: 0,
            config,
        }
    }

    #[must_use]
    pub fn config(&self) -> &DeviceConfig {
        &self.config
    }

    /// Newest [`MAX_RECEIVED_FRAMES`] received frames, oldest first; [`Snapshot::received_frames`] counts all.
    #[must_use]
    pub fn received(&self) -> &[ReceivedFrame] {
        self.log.frames()
    }

    /// Number of occurrences of each kind of fault.
    #[must_use]
    pub fn fault_counts(&self) -> &FaultCounts {
        &self.faults.counts
    }

    /// Whether the device accepts new connections: not while booting, and not while it refuses them.
    #[must_use]
    pub fn accepts_connections(&self) -> bool {
        !self.refuses_connections && self.booting_until.is_none()
    }
}

#[cfg(test)]
#[path = "testing.rs"]
mod testing;

#[cfg(test)]
#[path = "device_tests.rs"]
mod tests;
