//! The newest state, as clients are told.

use std::sync::Arc;

use super::super::Now;
use super::super::model::{LatchFields, State};
use super::Actor;
use crate::wsg::SystemState;

impl Actor {
    /// Publishes the state if it has changed.
    pub(super) fn publish(&mut self, now: Now) {
        let state = self.state_now();
        if *self.state.borrow().as_ref() == state {
            return;
        }
        self.sequence += 1;
        let info_is_stale = {
            let info = self.info.borrow();
            info.link != state.link || info.link_cause != state.link_cause
        };
        if info_is_stale {
            self.recording.link(now, state.link, state.link_cause.clone());
            let (link, cause) = (state.link, state.link_cause.clone());
            self.info.send_modify(|info| {
                let info = Arc::make_mut(info);
                info.link = link;
                info.link_cause = cause;
            });
        }
        self.state.send_replace(Arc::new(State { seq: self.sequence, ..state }));
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
            seq: self.sequence,
            state: observed.gripper_state.map(crate::wsg::GripperState::name),
            state_code: observed.gripper_state.map(crate::wsg::GripperState::code),
            flags: observed.flags.map(|flags| flags.names().collect()).unwrap_or_default(),
            flags_raw: observed.flags.map(|flags| flags.bits()),
            referenced,
            moving: flag(SystemState::MOVING),
            width_mm: observed.width_mm.filter(|_| referenced == Some(true)),
            speed_mm_s: observed.speed_mm_s,
            force_n: observed.force_n,
            temperature_c: observed.temperature.map(crate::wsg::Temperature::celsius),
            fast_stop: (observed.flags.is_some() || latch.is_some()).then_some(latch.is_some()),
            latch: latch.map(|latch| LatchFields::of(latch, self.latch.epoch())),
            lease_holder: self.lease.holder().map(|holder| holder.name.clone()),
            lease_epoch: self.lease.epoch(),
            journal_cause: self.recording.failure().map(ToOwned::to_owned),
            command: self.motion.id(),
        }
    }
}
