//! An actor, a simulated device, the wire between them, and a virtual clock.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use gripper::actor::{Actor, ActorConfig, Watches};
use gripper::{GripperMetrics, Now};
use jiff::{SignedDuration, Timestamp};
use model::{CustomIds, GripperRules, IdSource, Phase, ServoAdapter, ServoRules};
use prometheus::Registry;
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use sim::{Device, DeviceConfig, Interface, Part, Script, ScriptAnswer};
use transport::LinkProperties;

use super::client::Clients;
use super::invariants::Invariants;
use super::journal::Journal;
use super::leases::Leases;
use super::own_changes::OwnChanges;
use super::schedule::{Schedule, Step};
use super::servo::Servos;
use super::wire::Wire;

mod transfer;

/// Ids of a script that only reads, one that counts as motion, and one that streams motion.
pub const READ_ID: u8 = 0xB0;
pub const SCRIPT_ID: u8 = 0xB1;
pub const STREAM_ID: u8 = 0xB2;
/// Script of drivers, which the configuration does not declare.
pub const PORT_SCRIPT_ID: u8 = 0xB3;

/// Length of a schedule.
const SCHEDULE: Duration = Duration::from_secs(8);

/// Time for everything to come to rest afterwards: longer than the longest deadline.
const REST: Duration = Duration::from_secs(150);

/// Maximum number of due events, frames and records in one world, far above any real run.
const MAX_STEPS: u64 = 1_000_000;

/// The world of one seed.
pub struct World {
    pub rng: SmallRng,
    pub ids: IdSource,
    pub start: Instant,
    pub now: Instant,
    /// Steps of the wall clock so far.
    pub wall_offset: SignedDuration,
    pub config: ActorConfig,
    pub actor: Actor,
    pub watches: Watches,
    pub device: Device,
    pub clients: Clients,
    pub invariants: Invariants,
    pub journal: Journal,
    pub leases: Leases,
    pub own_changes: OwnChanges,
    pub servos: Servos,
    pub log: Vec<String>,
    pub counts: BTreeMap<String, u64>,
    connected: bool,
    pub interface: Interface,
    /// Number of due events, frames and records so far.
    steps: u64,
    reconnect_at: Option<Instant>,
    bytes_per_second: Option<u32>,
    pub longest_delay: Duration,
    /// End of the current frame on the line. Later frames wait, and can be overtaken.
    busy_until: Option<Instant>,
    to_device: Wire,
    to_gateway: Wire,
    /// End of the current stall of the device's output.
    stalled_until: Option<Instant>,
    /// End of the current stall of the requests.
    requests_stalled_until: Option<Instant>,
    /// Newest request and newest reply that are kept to be delivered late.
    old_datagrams: [Vec<u8>; 2],
    /// Whether the wire still damages bytes.
    pub noisy: bool,
}

impl World {
    /// Runs the schedule of a seed to its end, and checks the invariants after every step.
    pub fn run(seed: u64) -> Self {
        let mut world = Self::new(seed);
        let mut schedule = Schedule::new(&mut world.rng, SCHEDULE);
        let end = world.start + SCHEDULE;
        while world.now < end {
            let next = schedule.next_at(world.start);
            world.advance_to(next.unwrap_or(end).min(end));
            while let Some(step) = schedule.pop(world.now - world.start) {
                world.perform(step);
            }
        }
        world.come_to_rest();
        world.drain();
        world
    }

    /// Number of events by name.
    pub fn counts(&self) -> BTreeMap<String, u64> {
        let mut counts = self.counts.clone();
        for (name, count) in self.device.fault_counts().iter() {
            *counts.entry(format!("device: {name:?}")).or_default() += count;
        }
        counts
    }

    /// Time after which the gateway gives up an incomplete frame: that of the longest one, and the gap.
    pub fn longest_frame(&self) -> Duration {
        let line_time = self.bytes_per_second.map(|rate| Duration::from_secs(270) / rate);
        line_time.unwrap_or_default() + Duration::from_millis(150)
    }

    /// Whether gateway and device are connected.
    pub fn is_connected(&self) -> bool {
        self.connected
    }

    pub fn count(&mut self, name: &str, happened: bool) {
        *self.counts.entry(name.to_owned()).or_default() += u64::from(happened);
    }

    /// Returns a world without faults, with a ready device.
    pub fn calm(device: DeviceConfig, bytes_per_second: Option<u32>) -> Self {
        Self::calm_on(Interface::Tcp, device, bytes_per_second)
    }

    /// Returns a world without faults on another interface.
    pub fn calm_on(interface: Interface, device: DeviceConfig, bytes_per_second: Option<u32>) -> Self {
        let mut world = Self::with(0, interface, SmallRng::seed_from_u64(0), device, bytes_per_second);
        world.noisy = false;
        world.advance(Duration::from_secs(1));
        world
    }

    /// Delays all requests until this time is over. They then arrive in order.
    pub fn stall_requests(&mut self, time: Duration) {
        self.requests_stalled_until = Some(self.now + time);
    }

    /// Advances the clock.
    pub fn advance(&mut self, time: Duration) {
        self.settle();
        self.advance_to(self.now + time);
        self.settle();
    }

    fn new(seed: u64) -> Self {
        let mut rng = SmallRng::seed_from_u64(seed);
        let models = [DeviceConfig::wsg25(), DeviceConfig::wsg32(), DeviceConfig::wsg50(), DeviceConfig::wsg70()];
        let mut device = models[rng.random_range(0..models.len())].clone();
        if rng.random_bool(0.2) {
            device = device.fw2();
        }
        if rng.random_bool(0.7) {
            device = device.with_part(Part::outside(20.0));
        }
        device.scripts.extend(
            [READ_ID, SCRIPT_ID, STREAM_ID, PORT_SCRIPT_ID].map(|id| Script { id, answer: ScriptAnswer::Echo }),
        );
        // A slow line carries fewer updates, so its schedules run faster; some run at full rate.
        let bytes_per_second = [None, Some(11_520), Some(960), Some(960), Some(960)][rng.random_range(0..5)];
        let interfaces = [Interface::Tcp, Interface::Tcp, Interface::Udp, Interface::Serial, Interface::Can];
        let interface = interfaces[rng.random_range(0..interfaces.len())];
        let mut world = Self::with(seed, interface, rng, device, bytes_per_second);
        world.note(&format!("on {interface:?}"));
        world.count(&format!("interface: {interface:?}"), true);
        if world.rng.random_bool(0.1) {
            world.longest_delay = Duration::from_millis(world.rng.random_range(10..400));
        }
        if world.rng.random_bool(0.3) {
            // A problem exists before the first connect.
            let change = Schedule::any_change(&mut world.rng);
            world.note(&format!("at the start {change:?}"));
            world.device.apply(world.now, change);
        }
        world.settle();
        world
    }

    fn with(
        seed: u64,
        interface: Interface,
        rng: SmallRng,
        device: DeviceConfig,
        bytes_per_second: Option<u32>,
    ) -> Self {
        let now = Instant::now();
        let custom_ids = CustomIds { read: [READ_ID].into(), stream: [STREAM_ID].into(), ..CustomIds::default() };
        let servo = ServoRules { adapter: ServoAdapter::WidthSpeed, id: STREAM_ID, ..ServoRules::default() };
        let config = ActorConfig {
            gateway: "gateway".parse().unwrap(),
            name: "g".parse().unwrap(),
            url: "sim://g".to_owned(),
            properties: LinkProperties {
                name: "sim",
                connection_oriented: interface == Interface::Tcp,
                bytes_per_second,
                may_duplicate: interface == Interface::Udp,
                frame_gap: Duration::from_millis(100),
            },
            rules: GripperRules { custom_ids, servo, ..GripperRules::default() },
            seed,
            metrics: GripperMetrics::register(&Registry::new(), &"g".parse().unwrap()).unwrap(),
        };
        let (actor, watches) = Actor::new(config.clone());
        Self {
            config,
            ids: IdSource::new(!seed),
            rng,
            start: now,
            now,
            wall_offset: SignedDuration::ZERO,
            actor,
            watches,
            device: Device::new(device, now),
            clients: Clients::default(),
            invariants: Invariants::default(),
            journal: Journal::default(),
            leases: Leases::default(),
            own_changes: OwnChanges::default(),
            servos: Servos::default(),
            log: Vec::new(),
            counts: BTreeMap::new(),
            connected: false,
            interface,
            steps: 0,
            reconnect_at: Some(now),
            bytes_per_second,
            longest_delay: Duration::from_millis(3),
            busy_until: None,
            to_device: Wire::default(),
            to_gateway: Wire::default(),
            stalled_until: None,
            requests_stalled_until: None,
            old_datagrams: [Vec::new(), Vec::new()],
            noisy: true,
        }
    }

    pub fn clock(&self) -> Now {
        let elapsed = self.now - self.start;
        let wall = Timestamp::UNIX_EPOCH + SignedDuration::try_from(elapsed).unwrap() + self.wall_offset;
        Now { instant: self.now, wall, exact: wall }
    }

    pub fn note(&mut self, text: &str) {
        let at = (self.now - self.start).as_micros();
        self.log.push(format!("{:>10}.{:03} {text}", at / 1000, at % 1000));
    }

    /// Advances the clock to `until`, and handles everything that falls due.
    pub fn advance_to(&mut self, until: Instant) {
        loop {
            let due = [
                self.actor.poll_timeout(),
                self.device.poll_timeout(),
                self.to_device.due(),
                self.to_gateway.due(),
                self.reconnect_at,
                self.busy_until,
                self.journal.due(),
            ];
            let next = due.into_iter().flatten().min().filter(|next| *next <= until);
            let Some(next) = next else {
                self.now = self.now.max(until);
                return;
            };
            self.now = self.now.max(next);
            self.count_step();
            self.step();
        }
    }

    /// Counts one step, and fails beyond [`MAX_STEPS`].
    pub fn count_step(&mut self) {
        self.steps += 1;
        assert!(self.steps < MAX_STEPS, "the schedule does not end\n{}", self.tail());
    }

    fn step(&mut self) {
        self.busy_until = self.busy_until.filter(|until| *until > self.now);
        if self.device.poll_timeout().is_some_and(|at| at <= self.now) {
            self.device.handle_timeout(self.now);
            OwnChanges::watch(self);
        }
        while let Some(bytes) = self.to_device.take(self.now) {
            self.device_receives(&bytes);
        }
        while let Some(bytes) = self.to_gateway.take(self.now) {
            let now = self.clock();
            self.invariants.heard(self.now, &bytes);
            self.actor.receive(now, &bytes);
        }
        if self.actor.poll_timeout().is_some_and(|at| at <= self.now) {
            let now = self.clock();
            self.actor.handle_timeout(now);
        }
        if self.reconnect_at.is_some_and(|at| at <= self.now) {
            self.reconnect_at = None;
            self.connect();
        }
        self.settle();
    }

    /// Lets the device receive bytes, and carries out the targets in them.
    fn device_receives(&mut self, bytes: &[u8]) {
        let before = self.device.snapshot().received_frames;
        self.device.receive(self.now, bytes);
        Servos::carry_out(self, before);
        OwnChanges::watch(self);
    }

    fn connect(&mut self) {
        let now = self.clock();
        if self.device.connect(self.now, self.interface) {
            self.note("connected");
            self.connected = true;
            self.invariants.connected();
            self.actor.link_up(now);
        } else {
            self.actor.link_down(now, "refused");
            self.reconnect_at = Some(self.now + Duration::from_millis(100));
        }
    }

    /// Delivers everything that is ready, and runs the checks.
    pub fn settle(&mut self) {
        Journal::keep(self);
        self.move_to_device();
        self.move_to_gateway();
        Journal::keep(self);
        Clients::collect(self);
        OwnChanges::watch(self);
        OwnChanges::check(self);
        Leases::check(self);
        Leases::look(self);
        Servos::check(self);
        Invariants::check(self);
    }

    fn perform(&mut self, step: Step) {
        match step {
            Step::Change(change) => {
                self.note(&format!("{change:?}"));
                self.device.apply(self.now, change);
            }
            Step::Client(request) => Clients::act(self, request),
            Step::Stall(time) => {
                self.note(&format!("stalled for {time:?}"));
                self.stalled_until = Some(self.now + time);
                self.count("wire: device stalled", true);
            }
            Step::StallRequests(time) => {
                self.note(&format!("requests stalled for {time:?}"));
                self.stall_requests(time);
                self.count("wire: requests stalled", true);
            }
            Step::LateDatagrams => self.deliver_late_datagrams(),
        }
        self.settle();
    }

    /// Ends all faults; every command must then end and the link must recover.
    fn come_to_rest(&mut self) {
        self.note("coming to rest");
        self.noisy = false;
        for change in Schedule::healing() {
            self.device.apply(self.now, change);
        }
        self.settle();
        let since = self.now;
        while self.now < since + REST && !Invariants::is_at_rest(self, since) {
            self.advance_to(self.now + Duration::from_millis(100));
        }
        for ticket in self.clients.tickets() {
            assert_eq!(ticket.now().phase, Phase::Done, "command does not end: {:#?}\n{}", ticket.now(), self.tail());
        }
        Invariants::at_rest(self);
    }

    fn drain(&mut self) {
        let before = self.device.snapshot().received_frames;
        Clients::drain(self);
        self.settle();
        let latest = self.now + Duration::from_secs(10);
        while self.now < latest && self.connected {
            self.advance_to(self.now + Duration::from_millis(10));
        }
        assert!(!self.connected, "the link did not close in order");
        Invariants::drained(self, before);
    }

    pub fn tail(&self) -> String {
        self.log[self.log.len().saturating_sub(60)..].join("\n")
    }
}
