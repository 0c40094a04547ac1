//! The newest state, as clients see it.

use std::sync::Arc;

use tokio::sync::watch;

use super::super::Now;
use super::super::automatic_updates;
use super::super::info::Info;
use super::{Actor, ActorConfig};
use model::{Fault, LatchFields, Link, State};
use wsg::{DeviceTag, SystemState};

/// State and device information for clients to watch.
#[derive(Debug)]
pub(super) struct Publication {
    sequence: u64,
    updates: u64,
    state: watch::Sender<Arc<State>>,
    info: watch::Sender<Arc<Info>>,
}

impl Publication {
    pub(super) fn new(config: &ActorConfig) -> Self {
        let info = info_of(config);
        let state = State::unknown(config.name.clone());
        Self {
            sequence: 0,
            updates: 0,
            state: watch::Sender::new(Arc::new(state)),
            info: watch::Sender::new(Arc::new(info)),
        }
    }

    pub(super) fn watch(&self) -> (watch::Receiver<Arc<State>>, watch::Receiver<Arc<Info>>) {
        (self.state.subscribe(), self.info.subscribe())
    }

    pub(super) fn change_info(&self, change: impl FnOnce(&mut Info)) {
        self.info.send_modify(|info| change(Arc::make_mut(info)));
    }

    /// Publishes a new configuration. Known values of the device stay, unless the device is a new one.
    pub(super) fn reconfigure(&self, config: &ActorConfig, is_new_device: bool) {
        self.change_info(|info| {
            let new = info_of(config);
            *info = if is_new_device {
                new
            } else {
                let Info { stops_on_gateway_loss, custom_ids, update_period_ms, .. } = new;
                Info { stops_on_gateway_loss, custom_ids, update_period_ms, ..info.clone() }
            };
        });
    }

    /// Whether the device is known to have this tag.
    pub(super) fn has_tag(&self, tag: &DeviceTag) -> bool {
        self.info.borrow().device_tag.as_ref() == Some(&tag.text())
    }
}

/// Returns what the configuration tells about a gripper.
fn info_of(config: &ActorConfig) -> Info {
    let stops_on_gateway_loss = config.properties.connection_oriented && config.rules.fast_stop_on_disconnect;
    let name = config.name.clone();
    let url = config.url.clone();
    Info {
        custom_ids: Arc::new(config.rules.custom_ids.clone()),
        update_period_ms: automatic_updates::period_ms(config.rules.updates, config.properties.bytes_per_second),
        ..Info::unknown(name, url, config.properties.name, stops_on_gateway_loss)
    }
}

impl Actor {
    /// Publishes the state if it has changed. An update with the same values changes only the age, and wakes no
    /// subscriber.
    pub(super) fn publish(&mut self, now: Now) {
        let state = self.state_now(now);
        let (is_changed, is_newer) = {
            let published = self.publication.state.borrow();
            let is_changed = !published.is_like(&state);
            (is_changed, is_changed || published.values != state.values)
        };
        if !is_newer {
            return;
        }
        self.publication.updates += 1;
        if !is_changed {
            let state = Arc::new(State { update: self.publication.updates, ..state });
            self.publication.state.send_if_modified(|published| {
                *published = state;
                false
            });
            return;
        }
        self.publication.sequence += 1;
        let is_stale = {
            let info = self.publication.info.borrow();
            info.link != state.link || info.link_cause != state.link_cause
        };
        if is_stale {
            self.recording.link(now, state.link, state.link_cause.clone());
            self.publication.change_info(|info| {
                info.link = state.link;
                info.link_cause.clone_from(&state.link_cause);
            });
        }
        let seq = self.publication.sequence;
        let update = self.publication.updates;
        self.publication.state.send_replace(Arc::new(State { seq, update, ..state }));
    }

    fn state_now(&self, now: Now) -> State {
        let latch = self.latch.current();
        let last = &self.commands.last;
        let fault = self.fault(now);
        let is_known = latch.is_some() || self.observed.values.flags(now.instant).is_some();
        State {
            gripper: self.config.name.clone(),
            link: self.link.status(),
            link_cause: self.link.cause.clone(),
            values: self.observed.values,
            seq: self.publication.sequence,
            update: self.publication.updates,
            fault: fault.is_some(),
            fault_code: fault.map_or(0, Fault::code),
            fast_stop: is_known.then_some(latch.is_some()),
            latch: latch.map(|latch| LatchFields::of(latch, self.latch.epoch())),
            lease_holder: self.lease.holder().map(|holder| holder.name.clone()),
            reserved_for: self.lease.reserved().map(|holder| holder.name.clone()),
            lease_epoch: self.lease.epoch(),
            journal_cause: self.recording.failure().map(ToOwned::to_owned),
            command_id: self.motion.id(),
            command: self.motion.id(),
            last_command: last.number(),
            last_outcome: last.outcome(),
            last_command_id: last.id(),
            servo: self.servo.report(),
        }
    }

    /// The most important fault. A FAST STOP comes first, because only an acknowledgement ends it; then a lost link,
    /// because it hides the faults of the device.
    fn fault(&self, now: Now) -> Option<Fault> {
        if let Some(latch) = self.latch.current() {
            return Some(Fault::FastStop(latch.cause));
        }
        if self.link.status() != Link::Connected {
            return Some(Fault::LinkDown);
        }
        let flags = [
            (SystemState::TEMP_FAULT, Fault::Temperature),
            (SystemState::POWER_FAULT, Fault::Power),
            (SystemState::CURR_FAULT, Fault::Current),
            (SystemState::FINGER_FAULT, Fault::Finger),
        ];
        let flagged = flags.into_iter().find(|(flag, _)| self.observed.has(*flag)).map(|(_, fault)| fault);
        let others = [
            (self.observed.values.stale(now.instant).next().is_some(), Fault::ValueUnknown),
            (self.observed.has_error(), Fault::DeviceError),
            (self.settings.check().is_err(), Fault::SettingsLost),
            (self.recording.check().is_err(), Fault::JournalDown),
        ];
        flagged.or_else(|| others.into_iter().find(|(is_present, _)| *is_present).map(|(_, fault)| fault))
    }
}
