//! A gripper and its simulated device, with a real transport in between.

use std::sync::Arc;
use std::time::{Duration, Instant};

use prometheus::Registry;
use wsg_gateway::daemon::{ServedDevice, SimulatedDevice, Switch, serve_device};
use wsg_gateway::gripper::{self, Connector, GripperMetrics, Handle, Now, Rejection, Ticket};
use wsg_gateway::model::{Action, Client, CommandReport, Door, Link, Motion, Outcome, State, Submission};
use wsg_gateway::sim::{Change, DeviceConfig, FingerConfig, Part, Script, ScriptAnswer};
use wsg_gateway::wsg::{self, Data, HomingDirection, MoveFlags, Speed, SystemState, Width};

/// Generous deadline for everything except motions.
pub const SOON: Duration = Duration::from_secs(5);

pub struct Rig {
    pub handle: Handle,
    pub switch: Switch,
    pub is_tcp: bool,
}

pub fn client() -> Client {
    Client::new("test", Door::Http)
}

/// A device that knows every command.
pub fn device() -> DeviceConfig {
    let mut device = DeviceConfig::wsg50().with_part(Part::outside(20.0));
    device.fingers = [FingerConfig::Fmf, FingerConfig::Generic];
    // Close to where homing ends.
    device.start_width_mm = 100.0;
    device.scripts.push(Script { id: 0xB0, answer: ScriptAnswer::Echo });
    device
}

pub async fn served(url: &str) -> ServedDevice {
    serve_device(&url.parse().unwrap(), SimulatedDevice::new(device())).await.unwrap()
}

/// Starts a gripper for this address, even if no device is there.
pub fn spawn(connector: impl Connector) -> Handle {
    let custom_ids = wsg_gateway::model::CustomIds { read: (0xB0..=0xB7).collect(), ..Default::default() };
    let config = gripper::actor::ActorConfig {
        gateway: "gateway".parse().unwrap(),
        name: "g".parse().unwrap(),
        url: connector.url(),
        properties: connector.properties(),
        rules: wsg_gateway::model::GripperRules { custom_ids, ..Default::default() },
        seed: 1,
        metrics: GripperMetrics::register(&Registry::new(), &"g".parse().unwrap()).unwrap(),
    };
    gripper::spawn(
        config,
        Arc::new(connector),
        Arc::new(gripper::NullRecorder),
        gripper::recorder::RestoredState::default(),
    )
}

/// Whether a flag is set; `None` if unknown.
pub fn has(state: &State, flag: SystemState) -> Option<bool> {
    state.values.has(flag, Now::read().instant)
}

pub fn home() -> Motion {
    Motion::Home(HomingDirection::Default)
}

pub fn move_to(mm: f32, mm_s: f32) -> Motion {
    let flags = MoveFlags { relative: false, stop_on_block: true };
    Motion::Move { flags, width: Width::new(mm).unwrap(), speed: Speed::new(mm_s).unwrap() }
}

impl Rig {
    /// Connected, but not referenced.
    pub async fn new(url: &str) -> Self {
        let ServedDevice { address, switch, .. } = served(url).await;
        let is_tcp = address.properties().connection_oriented;
        let rig = Self { handle: spawn(address), switch, is_tcp };
        rig.link(Link::Connected, SOON).await;
        rig
    }

    /// Connected and referenced.
    pub async fn homed(url: &str) -> Self {
        let rig = Self::new(url).await;
        assert_eq!(rig.run(home()).await.outcome, Some(Outcome::Success));
        rig
    }

    pub async fn apply(&self, change: Change) {
        self.switch.apply(change).await.unwrap();
    }

    /// Waits until `is_so` accepts the state, and returns how long it took.
    pub async fn until(&self, what: &str, within: Duration, is_so: impl Fn(&State) -> bool) -> Duration {
        let begun = Instant::now();
        let mut states = self.handle.states();
        let waited = tokio::time::timeout(within, states.wait_for(|state| is_so(state))).await;
        assert!(waited.is_ok_and(|state| state.is_ok()), "{what}: not within {within:?}: {:#?}", self.handle.state());
        begun.elapsed()
    }

    pub async fn link(&self, link: Link, within: Duration) -> Duration {
        self.until(&format!("{link:?}"), within, |state| state.link == link).await
    }

    pub async fn submit(&self, action: Action) -> Result<Ticket, Rejection> {
        self.handle.submit(Submission { client: client(), action, request_id: None, lease: None }).await
    }

    pub async fn start(&self, motion: Motion) -> Ticket {
        self.submit(Action::Motion(motion)).await.unwrap()
    }

    pub async fn run(&self, motion: Motion) -> CommandReport {
        self.start(motion).await.wait(Duration::from_secs(30)).await
    }

    pub async fn exchange(&self, command: wsg::Command) -> Result<Data, Rejection> {
        self.handle.exchange(command, client(), None).await
    }

    /// Ids of all frames that the device received.
    pub async fn received(&self) -> Vec<u8> {
        self.switch.received().await.unwrap().iter().map(|frame| frame.id).collect()
    }

    pub async fn drain(self) {
        self.handle.drain().await;
    }
}
