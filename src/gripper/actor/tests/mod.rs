//! Tests of an actor whose device the test plays, so that the order of replies and updates is known.

use std::collections::BTreeSet;
use std::time::Duration;

use prometheus::Registry;
use tokio::sync::oneshot;

use super::*;
use crate::handle::ResultSender;
use model::error::Rejection;
use model::{Client, Door, FastStopCause, FastStopId, Reason, State, UpdateMode, UpdateRules};
use wsg::{Status, SystemState, frame};

mod fast_stop;
mod link;
mod motion;
mod rapid_changes;
mod reconfiguration;
mod steering;
mod streaming;

pub(crate) const TCP: LinkProperties = LinkProperties {
    name: "tcp",
    connection_oriented: true,
    bytes_per_second: None,
    may_duplicate: false,
    frame_gap: Duration::from_millis(100),
};

const UDP: LinkProperties = LinkProperties { name: "udp", connection_oriented: false, may_duplicate: true, ..TCP };

pub(crate) fn config(properties: LinkProperties) -> ActorConfig {
    ActorConfig {
        gateway: "gateway".parse().unwrap(),
        name: "g".parse().unwrap(),
        url: "test://g".to_owned(),
        properties,
        rules: GripperRules::default(),
        seed: 1,
        metrics: GripperMetrics::register(&Registry::new(), &"g".parse().unwrap()).unwrap(),
    }
}

pub(crate) fn client() -> Client {
    Client::new("test", Door::Http)
}

/// A referenced device without automatic updates.
struct Played {
    flags: SystemState,
    gripper_state: u8,
    force_n: f32,
    /// Whether an acknowledgement does not clear the FAST STOP.
    stays_stopped: bool,
    /// Ids whose replies the device holds back.
    held: BTreeSet<u8>,
    received: Vec<(u8, Vec<u8>)>,
}

impl Played {
    /// Executes a request. Returns the status and the data of the reply.
    fn execute(&mut self, id: u8, payload: &[u8]) -> (Status, Vec<u8>) {
        let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let data = match id {
            id::GET_SYSTEM_INFO => vec![1, 1, 0x20, 0x40, 7, 0, 0, 0],
            id::GET_SYSTEM_LIMITS => floats(&[110.0, 5.0, 420.0, 100.0, 5000.0, 5.0, 80.0, 120.0]),
            id::GET_SOFT_LIMITS | id::GET_DEVICE_TAG => return (Status::E_NOT_AVAILABLE, Vec::new()),
            id::GET_SYSTEM_STATE => self.flags.bits().to_le_bytes().to_vec(),
            id::GET_GRIPPER_STATE => vec![self.gripper_state],
            id::GET_WIDTH | id::GET_SPEED | id::GET_FORCE => floats(&[0.0]),
            id::GET_FORCE_LIMIT => floats(&[self.force_n]),
            id::GET_TEMPERATURE => vec![250, 0],
            id::SET_FORCE_LIMIT => {
                self.force_n = f32::from_le_bytes(payload.try_into().unwrap());
                Vec::new()
            }
            id::FAST_STOP => {
                self.flags |= SystemState::FAST_STOP;
                Vec::new()
            }
            id::ACKNOWLEDGE_FAST_STOP if !self.stays_stopped => {
                self.flags -= SystemState::FAST_STOP;
                Vec::new()
            }
            id::LOOP => payload.to_vec(),
            _ => Vec::new(),
        };
        (Status::E_SUCCESS, data)
    }
}

struct Rig {
    actor: Actor,
    watches: Watches,
    now: Now,
    ids: IdSource,
    device: Played,
}

impl Rig {
    fn connected(config: ActorConfig) -> Self {
        let (actor, watches) = Actor::new(config);
        let device = Played {
            flags: SystemState::REFERENCED,
            gripper_state: 0,
            force_n: 40.0,
            stays_stopped: false,
            held: BTreeSet::new(),
            received: Vec::new(),
        };
        let mut rig = Self { actor, watches, now: Now::read(), ids: IdSource::new(2), device };
        rig.actor.link_up(rig.now);
        rig.exchange();
        assert_eq!(rig.state().link, model::Link::Connected);
        rig.device.received.clear();
        rig
    }

    fn state(&self) -> State {
        State::clone(&self.watches.state.borrow())
    }

    /// Exchanges frames with the device, and records with a journal, until both have nothing to say.
    fn exchange(&mut self) {
        let mut request = Vec::new();
        loop {
            while let Some((_, awaited_by)) = self.actor.poll_record() {
                if let Some(id) = awaited_by {
                    self.actor.recorded(self.now, id, true);
                }
            }
            request.clear();
            if !self.actor.poll_transmit(self.now, &mut request) {
                return;
            }
            let (id, payload) = (request[3], &request[6..request.len() - 2]);
            self.device.received.push((id, payload.to_vec()));
            if !self.device.held.contains(&id) {
                let (status, data) = self.device.execute(id, payload);
                self.reply(id, status, &data);
            }
        }
    }

    /// Sends a reply of the device, or an automatic update.
    fn reply(&mut self, id: u8, status: Status, data: &[u8]) {
        let mut bytes = Vec::new();
        frame::encode(id, &[&status.code().to_le_bytes(), data].concat(), &mut bytes);
        self.actor.receive(self.now, &bytes);
    }

    fn pass(&mut self, milliseconds: u64) {
        self.now.instant += Duration::from_millis(milliseconds);
        self.actor.handle_timeout(self.now);
        self.exchange();
    }

    fn request<T>(
        &mut self,
        make: impl FnOnce(ResultSender<T>) -> ActorRequest,
    ) -> oneshot::Receiver<Result<T, Rejection>> {
        let (answer, answered) = oneshot::channel();
        self.actor.request(self.now, make(answer));
        self.exchange();
        answered
    }

    fn fast_stop(&mut self) -> FastStopId {
        let id = self.ids.fast_stop_id(self.now.wall);
        let (cause, reason) = (FastStopCause::Requested, Reason::truncated(""));
        let request = FastStopRequest { id, client: client(), cause, reason, at: self.now.instant, epoch: None };
        self.actor.fast_stop(self.now, request);
        self.exchange();
        id
    }

    /// Number of requests of this id that the device has received.
    fn count(&self, id: u8) -> usize {
        self.device.received.iter().filter(|(received, _)| *received == id).count()
    }
}
