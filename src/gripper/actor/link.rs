//! The link's life: up, set up, silent, down.

use std::time::Duration;

use super::super::Now;
use super::super::error::{Failure, Rejection};
use super::super::latch;
use super::super::model::{DeviceEvent, Link, Outcome};
use super::super::observed;
use super::super::setup::{Setup, Step};
use super::{Actor, Close, LinkState, Purpose, REPLY_WITHIN};
use crate::wsg::session::{self, Session};
use crate::wsg::{Command, SystemState};

/// A link without a sign of life for so long is unresponsive: motions are refused.
pub(super) const UNRESPONSIVE_AFTER: Duration = Duration::from_millis(1500);

/// And after so much more it is closed.
pub(super) const CLOSED_AFTER: Duration = Duration::from_millis(6500);

impl Actor {
    /// A link has come up.
    pub fn link_up(&mut self, now: Now) {
        // Where there are no connections, every attempt comes so far.
        tracing::debug!(gripper = %self.config.name, url = self.config.url, "opened, setting up");
        let traits = self.config.traits;
        let config = session::Config {
            bytes_per_second: traits.bytes_per_second,
            frame_gap: traits.frame_gap,
            may_duplicate: traits.may_duplicate,
            nonce_seed: self.ids.nonce(),
        };
        self.session = Some(Session::new(config, now.instant));
        self.metering.link_up();
        self.close = None;
        self.wire_log.link_up();
        self.link = LinkState::SettingUp(Box::new(self.new_setup()));
        // A FAST STOP that the device may not have heard of goes before everything else.
        self.send_fast_stop_if_due(now);
        self.continue_setup(now);
        self.settle(now);
    }

    /// The link is gone, or could not be made.
    pub fn link_down(&mut self, now: Now, cause: &str) {
        let unwritten = self.running.as_ref().and_then(super::Running::token).is_some_and(|token| self.withdraw(token));
        self.metering.session(self.session.as_mut());
        let mut session = self.session.take();
        if session.is_some() && self.close == Some(Close::Drained) {
            tracing::info!(gripper = %self.config.name, "link closed");
            self.unannounced = false;
        } else {
            if matches!(self.link, LinkState::Up) {
                tracing::warn!(gripper = %self.config.name, cause, "link lost");
            } else if self.link_cause.as_deref() != Some(cause) {
                tracing::warn!(gripper = %self.config.name, cause, "no link");
            }
            if session.is_some() {
                self.unannounced = self.config.traits.connection_oriented;
            }
        }
        self.link = LinkState::Down;
        self.link_cause = Some(cause.to_owned());
        self.close = None;
        let rejection = Rejection::Failure(self.link_down_failure());
        self.latch.link_lost(&rejection);
        self.reads.reject_all(&rejection);
        self.tag_writes.forget();
        for (_, answer) in std::mem::take(&mut self.awaiting_flags) {
            let _ = answer.send(Err(rejection.clone()));
        }
        for (token, purpose) in std::mem::take(&mut self.purposes) {
            match purpose {
                Purpose::Exchange(exchange) => {
                    let _ = exchange.answer.send(Err(rejection.clone()));
                }
                Purpose::Stop(Some(id)) if session.as_mut().is_some_and(|session| session.withdraw(token)) => {
                    self.reject(now, id, rejection.clone());
                }
                // It may have happened.
                Purpose::Stop(Some(id)) => self.end(now, id, |record| record.outcome = Some(Outcome::Unknown)),
                _ => {}
            }
        }
        self.end_running(now, unwritten);
        self.settle(now);
    }

    /// Whether the link is up, and the device has said what it is.
    #[must_use]
    pub fn is_set_up(&self) -> bool {
        matches!(self.link, LinkState::Up)
    }

    /// How the link is, as clients are told.
    pub(super) fn link_now(&self) -> Link {
        match (&self.link, self.was_connected) {
            (LinkState::Up, _) if self.link_cause.is_some() => Link::Unresponsive,
            (LinkState::Up, _) => Link::Connected,
            (_, true) => Link::Reconnecting,
            (_, false) => Link::Connecting,
        }
    }

    /// The device was silent, or its automatic updates had stopped. Where no connection ends with a restart, it may have
    /// been one: what is under way goes on, and nothing new moves before the settings are known to be as clients left
    /// them.
    pub(super) fn set_up_again(&mut self, now: Now) {
        if self.config.traits.connection_oriented || !matches!(self.link, LinkState::Up) || self.close.is_some() {
            return;
        }
        let cause = "its updates had stopped: it may have restarted, and is being set up again";
        tracing::warn!(gripper = %self.config.name, "{cause}");
        self.link_cause = Some(cause.to_owned());
        self.link = LinkState::SettingUp(Box::new(self.new_setup()));
        self.continue_setup(now);
    }

    fn new_setup(&self) -> Setup {
        Setup::new(self.config.traits.bytes_per_second, self.known_serial, self.wanted)
    }

    /// Sends the set-up's next request, or ends it.
    pub(super) fn continue_setup(&mut self, now: Now) {
        loop {
            let LinkState::SettingUp(setup) = &mut self.link else { return };
            match setup.next() {
                Step::Send(command) => {
                    let token = self.submit(now, command, Purpose::Setup).ok();
                    if let LinkState::SettingUp(setup) = &mut self.link {
                        setup.sent(token);
                    }
                    if token.is_some() {
                        return;
                    }
                }
                Step::Done => return self.finish_setup(now),
                Step::Failed(command) => {
                    self.close = Some(Close::SetupFailed(command));
                    return;
                }
            }
        }
    }

    fn finish_setup(&mut self, now: Now) {
        let LinkState::SettingUp(setup) = std::mem::replace(&mut self.link, LinkState::Up) else { return };
        let name = self.config.name.clone();
        if setup.replaced {
            let serial = setup.system.map(|system| system.serial_number);
            if let (Some(known_serial_number), Some(serial_number)) = (self.known_serial, serial) {
                self.recording.device(now, DeviceEvent::Replaced { known_serial_number, serial_number });
            }
            tracing::warn!(gripper = %name, serial, "another device answers: its settings are left as they are");
        }
        if !setup.restored.is_empty() {
            tracing::warn!(gripper = %name, settings = ?setup.restored, "the device had lost settings: set again");
        }
        if !setup.lost.is_empty() {
            tracing::warn!(gripper = %name, settings = ?setup.lost, "settings could not be restored: nothing moves");
        }
        let overdrive = self.observed.has(SystemState::OVERDRIVE_MODE);
        if self.overdrive_wanted && !overdrive {
            tracing::warn!(gripper = %name, "Overdrive Mode is off since the device restarted, and stays off");
            self.overdrive_wanted = false;
        }
        self.recording.restored(now, &setup.restored, self.wanted);
        self.wanted = setup.wanted();
        if let (Some(wanted), Some(limits), false) = (self.wanted.force_limit, setup.limits, overdrive) {
            // Without overdrive the device has clamped it, and would be found changed at each reconnect.
            self.wanted.force_limit = Some(if wanted > limits.nominal_force { limits.nominal_force } else { wanted });
        }
        self.lost = setup.lost;
        for update in observed::switch_on_all(None) {
            // Those that don't come are switched on again.
            self.observed.asked(now.instant, update.id());
        }
        self.system = setup.system;
        let serial = setup.system.map(|system| system.serial_number);
        if self.known_serial != serial {
            self.known_serial = serial;
            self.remember_settings();
        }
        self.limits.system = setup.limits;
        self.limits.soft = setup.soft_limits;
        if let (Some(system), Some(limits)) = (setup.system, setup.limits) {
            self.info.send_modify(|info| {
                std::sync::Arc::make_mut(info).learn(&system, &limits, setup.tag.as_ref());
            });
        }
        if let (false, Some(session)) = (self.observed.has(SystemState::MOVING), &mut self.session) {
            // A motion that a restart has ended gets no result.
            session.expect_results(now.instant);
        }
        self.metering.set_up(self.was_connected);
        self.was_connected = true;
        self.link_cause = None;
        self.unannounced = false;
        self.temperature_at = Some(now.instant);
        tracing::info!(gripper = %name, "ready");
    }

    /// Notices silence, and its end.
    pub(super) fn supervise(&mut self, now: Now) {
        let Some(session) = &self.session else { return };
        let silent_for = now.instant.saturating_duration_since(session.last_heard());
        if !matches!(self.link, LinkState::Up) {
            return;
        }
        if silent_for >= CLOSED_AFTER {
            self.close = Some(Close::Silent(silent_for.as_millis() as u64));
        } else if silent_for >= UNRESPONSIVE_AFTER {
            if self.link_cause.is_none() {
                let cause = format!("nothing heard from the device for {} ms", UNRESPONSIVE_AFTER.as_millis());
                tracing::warn!(gripper = %self.config.name, cause, "unresponsive");
                self.link_cause = Some(cause);
            }
        } else if self.link_cause.take().is_some() {
            tracing::info!(gripper = %self.config.name, "responsive again");
            self.set_up_again(now);
        }
    }

    /// Sends 23h if it is due: right after the request, and again until it is confirmed.
    pub(super) fn send_fast_stop_if_due(&mut self, now: Now) {
        if self.session.is_none() || !self.latch.is_due(now.instant) {
            return;
        }
        let sent = self.submit_within(now, Command::FastStop, Purpose::FastStop, latch::REPEAT_EVERY, REPLY_WITHIN);
        self.latch.sent(now.instant, sent.ok());
    }

    /// Whether commands can be sent, and if not, why.
    pub(super) fn check_link(&self) -> Result<(), Failure> {
        if self.drain.is_some() {
            return Err(Failure::Draining);
        }
        match self.link_now() {
            Link::Connected => Ok(()),
            _ => Err(self.link_down_failure()),
        }
    }
}
