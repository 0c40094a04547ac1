//! The newest state, as clients see it.

use std::sync::Arc;

use tokio::sync::watch;

use super::super::Now;
use super::super::info::Info;
use super::super::model::{LatchFields, State};
use super::{Actor, ActorConfig};
use crate::wsg::{DeviceTag, GripperState, SystemState, Temperature};

/// State and device information for clients to watch.
#[derive(Debug)]
pub(super) struct Publication {
    sequence: u64,
    state: watch::Sender<Arc<State>>,
    info: watch::Sender<Arc<Info>>,
}

impl Publication {
    pub(super) fn new(config: &ActorConfig) -> Self {
        let info = Info::unknown(
            config.name.clone(),
            config.url.clone(),
            config.properties.name,
            config.properties.connection_oriented && config.fast_stop_on_disconnect,
        );
        let state = State::unknown(config.name.clone());
        Self { sequence: 0, state: watch::Sender::new(Arc::new(state)), info: watch::Sender::new(Arc::new(info)) }
    }

    pub(super) fn watch(&self) -> (watch::Receiver<Arc<State>>, watch::Receiver<Arc<Info>>) {
        (self.state.subscribe(), self.info.subscribe())
    }

    pub(super) fn change_info(&self, change: impl FnOnce(&mut Info)) {
        self.info.send_modify(|info| change(Arc::make_mut(info)));
    }

    /// Whether the device is known to have this tag.
    pub(super) fn has_tag(&self, tag: &DeviceTag) -> bool {
        self.info.borrow().device_tag.as_deref() == Some(tag.as_str())
    }
}

impl Actor {
    /// Publishes the state if it has changed.
    pub(super) fn publish(&mut self, now: Now) {
        let state = self.state_now();
        if *self.publication.state.borrow().as_ref() == state {
            return;
        }
        self.publication.sequence += 1;
        let is_stale = |info: &Info| info.link != state.link || info.link_cause != state.link_cause;
        if is_stale(&self.publication.info.borrow()) {
            self.recording.link(now, state.link, state.link_cause.clone());
            self.publication.change_info(|info| {
                info.link = state.link;
                info.link_cause.clone_from(&state.link_cause);
            });
        }
        self.publication.state.send_replace(Arc::new(State { seq: self.publication.sequence, ..state }));
    }

    fn state_now(&self) -> State {
        let observed = &self.observed;
        let flag = |flag| observed.flags.map(|flags| flags.contains(flag));
        let referenced = flag(SystemState::REFERENCED);
        let latch = self.latch.current();
        State {
            gripper: self.config.name.clone(),
            link: self.link.status(),
            link_cause: self.link.cause.clone(),
            updated_at: observed.updated_at,
            seq: self.publication.sequence,
            state: observed.gripper_state.map(GripperState::name),
            state_code: observed.gripper_state.map(GripperState::code),
            flags: observed.flags.map(|flags| flags.names().collect()).unwrap_or_default(),
            flags_raw: observed.flags.map(|flags| flags.bits()),
            referenced,
            moving: flag(SystemState::MOVING),
            width_mm: observed.width_mm.filter(|_| referenced == Some(true)),
            speed_mm_s: observed.speed_mm_s,
            force_n: observed.force_n,
            temperature_c: observed.temperature.map(Temperature::celsius),
            fast_stop: (observed.flags.is_some() || latch.is_some()).then_some(latch.is_some()),
            latch: latch.map(|latch| LatchFields::of(latch, self.latch.epoch())),
            lease_holder: self.lease.holder().map(|holder| holder.name.clone()),
            lease_epoch: self.lease.epoch(),
            journal_cause: self.recording.failure().map(ToOwned::to_owned),
            command_id: self.motion.id(),
            command: self.motion.id(),
        }
    }
}
