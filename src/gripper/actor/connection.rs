//! What the life of the link means for the rest of the gripper: up, set up, silent, down.

use super::super::Now;
use super::super::error::{Failure, Rejection};
use super::super::latch;
use super::super::model::{DeviceEvent, Link, Outcome};
use super::super::observed;
use super::super::setup::Setup;
use super::link::Purpose;
use super::running::Running;
use super::{Actor, REPLY_WITHIN};
use crate::wsg::{Command, SystemState};

impl Actor {
    /// A link has come up.
    pub fn link_up(&mut self, now: Now) {
        // Without connections, every attempt comes so far.
        tracing::debug!(gripper = %self.config.name, url = self.config.url, "opened, setting up");
        let nonce = self.ids.nonce();
        let setup = self.new_setup();
        self.link.open(now.instant, nonce, setup);
        self.metering.link_up();
        // A FAST STOP that the device may not have heard of goes before everything else.
        self.send_fast_stop_if_due(now);
        self.continue_setup(now);
        self.after_input(now);
    }

    /// The link is gone, or could not be made.
    pub fn link_down(&mut self, now: Now, cause: &str) {
        let token = self.motion.running.as_ref().and_then(Running::token);
        let unwritten = token.is_some_and(|token| self.link.withdraw(token));
        self.metering.session(self.link.session.as_mut());
        let in_flight = self.link.down(cause);
        let rejection = Rejection::Failure(self.link.failure());
        self.latch.link_lost(&rejection);
        self.reads.reject_all(&rejection);
        self.settings.tag_writes.forget();
        self.settings.overdrive.reject_all(&rejection);
        for purpose in in_flight {
            match purpose {
                (Purpose::Exchange(exchange), _) => {
                    let _ = exchange.answer.send(Err(rejection.clone()));
                }
                (Purpose::Stop(Some(id)), true) => self.reject(now, id, rejection.clone()),
                // It may have happened.
                (Purpose::Stop(Some(id)), false) => {
                    self.end(now, id, |record| record.outcome = Some(Outcome::Unknown));
                }
                _ => {}
            }
        }
        self.end_running(now, unwritten);
        self.after_input(now);
    }

    /// Whether the link is up, and the device has said what it is.
    #[must_use]
    pub fn is_set_up(&self) -> bool {
        self.link.is_up()
    }

    /// The device was silent, or its automatic updates had stopped. Where no connection ends with a restart, it may have
    /// been one: what is under way goes on, and nothing new moves before the settings are known to be as clients left
    /// them.
    pub(super) fn set_up_again(&mut self, now: Now) {
        if self.link.properties.connection_oriented || !self.link.is_up() || self.link.close.is_some() {
            return;
        }
        let cause = "its updates had stopped: it may have restarted, and is being set up again";
        tracing::warn!(gripper = %self.config.name, "{cause}");
        self.link.cause = Some(cause.to_owned());
        let setup = self.new_setup();
        self.link.set_up(setup);
        self.continue_setup(now);
    }

    fn new_setup(&self) -> Setup {
        Setup::new(self.link.properties.bytes_per_second, self.settings.known_serial, self.settings.wanted)
    }

    /// Sends the set-up's next request, or ends it.
    pub(super) fn continue_setup(&mut self, now: Now) {
        if let Some(setup) = self.link.continue_setup(now) {
            self.finish_setup(now, *setup);
        }
    }

    fn finish_setup(&mut self, now: Now, mut setup: Setup) {
        let name = self.config.name.clone();
        if setup.replaced {
            let serial = setup.system.map(|system| system.serial_number);
            if let (Some(known_serial_number), Some(serial_number)) = (self.settings.known_serial, serial) {
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
        if !overdrive && self.settings.overdrive.give_up() {
            tracing::warn!(gripper = %name, "Overdrive Mode is off since the device restarted, and stays off");
        }
        self.recording.restored(now, &setup.restored, self.settings.wanted);
        if self.settings.learn(&mut setup, overdrive) {
            self.persist_settings();
        }
        for update in observed::switch_on_all(None) {
            // Those that don't come are switched on again.
            self.observed.asked(now.instant, update.id());
        }
        if let (Some(system), Some(limits)) = (setup.system, setup.limits) {
            self.publication.change_info(|info| info.learn(&system, &limits, setup.tag.as_ref()));
        }
        if let (false, Some(session)) = (self.observed.has(SystemState::MOVING), &mut self.link.session) {
            // A motion that a restart has ended gets no result.
            session.expect_results(now.instant);
        }
        self.metering.set_up(self.link.was_up);
        self.link.ready();
        self.observed.temperature_at = Some(now.instant);
        tracing::info!(gripper = %name, "ready");
    }

    /// Notices silence, and its end.
    pub(super) fn supervise(&mut self, now: Now) {
        if self.link.supervise(now.instant) {
            tracing::info!(gripper = %self.config.name, "responsive again");
            self.set_up_again(now);
        }
    }

    /// Sends 23h if it is due: right after the request, and again until it is confirmed.
    pub(super) fn send_fast_stop_if_due(&mut self, now: Now) {
        if self.link.session.is_none() || !self.latch.is_due(now.instant) {
            return;
        }
        let sent =
            self.link.submit_within(now, Command::FastStop, Purpose::FastStop, latch::REPEAT_EVERY, REPLY_WITHIN);
        self.latch.sent(now.instant, sent.ok());
    }

    /// Whether commands can be sent, and if not, why.
    pub(super) fn check_link(&self) -> Result<(), Failure> {
        if self.drain.is_some() {
            return Err(Failure::Draining);
        }
        match self.link.status() {
            Link::Connected => Ok(()),
            _ => Err(self.link.failure()),
        }
    }
}
