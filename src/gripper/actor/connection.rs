//! Effects of the link on the rest of the gripper: connected, set up, silent, lost.

use super::super::Now;
use super::super::automatic_updates;
use super::super::latch;
use super::super::setup::Setup;
use super::link::{OwnStop, Purpose};
use super::running::Running;
use super::{Actor, REPLY_WITHIN};
use model::error::{Failure, Rejection};
use model::{DeviceEvent, Link, Outcome, ServoEnd};
use wsg::{Command, SystemState};

impl Actor {
    /// Notes an attempt to connect, which ends with [`Actor::link_up`] or [`Actor::link_down`].
    pub fn connecting(&mut self) {
        self.link.is_connecting = true;
    }

    /// Starts a session on a new link.
    pub fn link_up(&mut self, now: Now) {
        // Debug level: on a transport without connections, every attempt gets this far.
        tracing::debug!(gripper = %self.config.name, url = self.config.url, "link opened, setting up");
        let nonce = self.ids.nonce();
        let setup = self.new_setup();
        self.link.open(now.instant, nonce, setup);
        self.observed.link_up(now);
        self.start_pacing(now);
        self.metering.link_up();
        // A FAST STOP that the device may not have received goes before everything else.
        self.send_fast_stop_if_due(now);
        self.continue_setup(now);
        self.after_input(now);
    }

    /// Takes the loss of the link, or a failed attempt to connect.
    pub fn link_down(&mut self, now: Now, cause: &str) {
        self.stop_servo(now, ServoEnd::Link);
        let token = self.motion.running.as_ref().and_then(Running::token);
        let unwritten = token.is_some_and(|token| self.link.withdraw(token));
        let _ = self.metering.session(self.link.session.as_mut());
        let in_flight = self.link.down(cause);
        self.observed.link_down();
        let rejection = Rejection::Failure(self.link.failure());
        self.latch.link_lost(&rejection);
        self.reads.reject_all(&rejection);
        self.settings.tag_writes.forget();
        self.settings.overdrive.reject_all(&rejection);
        let mut lost = None;
        for purpose in in_flight {
            match purpose {
                (Purpose::Exchange(exchange), _) => {
                    self.answers.add(exchange.answer, Err(rejection.clone()));
                }
                (Purpose::Stop(id), true) => self.reject(now, id, rejection.clone()),
                // The Stop may have happened.
                (Purpose::Stop(id), false) => {
                    self.end(now, id, |record| {
                        record.set_outcome(Outcome::Unknown);
                        record.explain(rejection.code(), &rejection);
                    });
                }
                (Purpose::OwnStop(stop), _) => {
                    self.link.owed_stop = Some(OwnStop::new(stop.motion));
                    lost = lost.or(stop.lost);
                }
                _ => {}
            }
        }
        self.end_running(now, unwritten);
        if let Some(holder) = lost.filter(|_| self.is_moving(now.instant) && self.latch.id().is_none()) {
            // Nobody knows whether the Stop has reached the device.
            self.fast_stop_for_lost(now, &holder);
        }
        if let Some(answer) = self.end_link_drain() {
            self.answers.add(answer, Ok(()));
        }
        self.finish_reconfiguration();
        self.after_input(now);
    }

    /// Whether a request that was written may act on the gripper later, because nothing shows that it has arrived.
    #[must_use]
    pub fn may_act_late(&self) -> bool {
        self.link.session.as_ref().is_some_and(wsg::session::Session::may_act_late)
    }

    /// Whether the link is up, and the device has been identified.
    #[must_use]
    pub fn is_set_up(&self) -> bool {
        self.link.is_up()
    }

    /// Whether a FAST STOP is latched that the device has not confirmed.
    #[must_use]
    pub fn owes_fast_stop(&self) -> bool {
        self.latch.is_unconfirmed()
    }

    /// Sets up the device again after silence or missing updates. Without connections, these can be the only sign of a
    /// restart. A running motion continues; no new one starts until the clients' settings are checked.
    pub(super) fn set_up_again(&mut self, now: Now) {
        if self.link.properties.connection_oriented || !self.link.is_up() || self.link.close.is_some() {
            return;
        }
        let cause = "device updates had stopped (possible restart): setting up again";
        tracing::warn!(gripper = %self.config.name, "{cause}");
        self.link.cause = Some(cause.to_owned());
        self.link.await_setters();
        self.begin_waiting_setup(now);
    }

    /// Begins a waiting setup, unless a setter is in flight.
    pub(super) fn begin_waiting_setup(&mut self, now: Now) {
        if self.drain.is_none() && self.link.can_set_up() {
            let setup = self.new_setup();
            self.link.set_up(setup);
            self.continue_setup(now);
        }
    }

    /// Requests that switch on all automatic updates.
    fn switch_on_updates(&self) -> impl Iterator<Item = Command> + use<> {
        automatic_updates::switch_on_all(self.update_rules(), self.link.properties.bytes_per_second)
    }

    /// Request that reads the flags.
    pub(super) fn read_flags(&self) -> Command {
        automatic_updates::read_flags(self.update_rules(), self.link.properties.bytes_per_second)
    }

    fn new_setup(&self) -> Setup {
        Setup::new(self.switch_on_updates(), self.settings.known_serial, self.settings.wanted)
    }

    /// Sends the next request of the setup, or ends the setup.
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
            tracing::warn!(gripper = %name, serial, "different device connected: its settings are left unchanged");
        }
        if !setup.restored.is_empty() {
            tracing::warn!(gripper = %name, settings = ?setup.restored, "settings restored: the device had lost them");
        }
        if !setup.lost.is_empty() {
            tracing::warn!(gripper = %name, settings = ?setup.lost,
                "settings could not be restored: motion is blocked until they are set again");
        }
        let overdrive = self.observed.has(SystemState::OVERDRIVE_MODE);
        if !overdrive && self.settings.overdrive.give_up() {
            tracing::warn!(gripper = %name, "Overdrive Mode was lost in a device restart: enable it again if needed");
        }
        if self.settings.learn(&mut setup) {
            self.persist_settings();
        }
        self.recording.restored(now, &setup.restored, self.settings.wanted);
        for update in self.switch_on_updates() {
            // Updates that do not arrive are switched on again.
            self.observed.requested(now.instant, update.id());
        }
        if let (Some(system), Some(limits)) = (setup.system, setup.limits) {
            self.publication.change_info(|info| info.learn(&system, &limits, setup.tag.as_ref()));
        }
        if let (false, Some(session)) = (self.observed.has(SystemState::MOVING), &mut self.link.session) {
            // A motion that a restart ended gets no result from the device.
            session.expect_results(now.instant);
        }
        self.latch.link_set_up(now.instant, self.observed.last_flags());
        self.unconfirmed.forget();
        self.metering.set_up(self.link.was_up);
        self.link.ready();
        self.observed.link_set_up(now.instant, self.settings.has_temperature());
        tracing::info!(gripper = %name, "link established");
        if let Some(stop) = self.link.owed_stop.take() {
            self.send_owed_stop(now, stop);
        }
    }

    /// Sends the Stop that is still owed after a lost link, if its motion is still running.
    fn send_owed_stop(&mut self, now: Now, stop: OwnStop) {
        let runs = self.observed.has(SystemState::MOVING) && self.motion.mover(now.instant) == stop.motion;
        if runs && stop.motion.is_some() && self.latch.id().is_none() {
            self.link.send_stop(now, stop);
        }
    }

    /// Sends 23h if due: right after the request, and again until the FAST STOP is confirmed.
    pub(super) fn send_fast_stop_if_due(&mut self, now: Now) {
        if self.link.session.is_none() || !self.latch.is_due(now.instant) {
            return;
        }
        let sent =
            self.link.submit_within(now, Command::FastStop, Purpose::FastStop, latch::REPEAT_EVERY, REPLY_WITHIN);
        self.latch.sent(now.instant, sent.ok());
    }

    /// Checks that commands can be sent.
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
