//! Events of the session: updates, acceptances and ends of requests.

use super::super::Now;
use super::super::automatic_updates;
use super::super::latch::{LatchChange, Origin};
use super::Actor;
use super::link::{Close, Exchange, OwnStop, Purpose};
use model::{DeviceEvent, FastStopCause, FastStopStep, Missing, SettingChange, UpdateMode};
use wsg::session::{End, SessionEvent, Token};
use wsg::{Command, Data, GripperState, Reply, Status, SystemState, id};

impl Actor {
    /// Processes all pending events of the session.
    pub(super) fn take_events(&mut self, now: Now) {
        while let Some(event) = self.link.poll_event() {
            match event {
                SessionEvent::Update(data) => self.take_update(now, &data),
                SessionEvent::NoValue(id, reason) => self.take_no_value(id, reason),
                SessionEvent::LongReply(id, bytes) => {
                    tracing::warn!(gripper = %self.config.name, command = id::name(id), bytes,
                        "reply longer than the manuals say: its known fields are used");
                }
                SessionEvent::Accepted(token) => self.take_accepted(now, token),
                SessionEvent::Ended(token, end) => {
                    self.note_change(now, token);
                    if let Some(purpose) = self.link.purposes.remove(&token) {
                        self.take_end(now, token, purpose, end);
                        self.begin_waiting_setup(now);
                    }
                }
            }
        }
    }

    fn take_accepted(&mut self, now: Now, token: Token) {
        self.note_change(now, token);
        match self.link.purposes.get_mut(&token) {
            Some(Purpose::Motion(id)) => {
                let id = *id;
                self.motion_accepted(id);
            }
            Some(Purpose::Exchange(exchange)) => {
                if let Some(accepted) = exchange.accepted.take() {
                    self.answers.add(accepted, ());
                }
            }
            _ => {}
        }
    }

    /// Notes that the device has answered a request that can have changed its values.
    fn note_change(&mut self, now: Now, token: Token) {
        let is_change = match self.link.purposes.get(&token) {
            Some(Purpose::Exchange(exchange)) => exchange.setter.is_none() && !self.only_reads(&exchange.command),
            Some(
                Purpose::FastStop
                | Purpose::Acknowledge
                | Purpose::Force(..)
                | Purpose::ServoForce(..)
                | Purpose::Motion(_)
                | Purpose::Stop(_)
                | Purpose::OwnStop(_),
            ) => true,
            _ => false,
        };
        if is_change {
            self.observed.values.changed_at = Some(now.instant);
            self.reads.forget();
        }
    }

    fn take_update(&mut self, now: Now, data: &Data) {
        self.metering.metrics.updates.inc();
        let before = self.observed.last_flags();
        let state_before = self.observed.last_state();
        if self.link.properties.may_duplicate && self.needs_second_look(now, data) {
            return;
        }
        let missed = matches!(data, Data::SystemState(_)) && self.observed.were_missed(now.instant);
        if let Data::Width(width) = data {
            self.servo.moved(self.observed.values.width_mm(now.instant), *width);
        }
        self.observed.take(now.instant, data);
        let flags = match *data {
            Data::SystemState(flags) => flags,
            Data::GripperState(_) => return self.record_gripper_state(now, state_before),
            // The force is the last value of each update period.
            Data::Force(_) => return self.recording.measure(now, &self.observed.values),
            // In this mode, the width can arrive without the other values.
            Data::Width(_) if self.config.rules.updates.mode == UpdateMode::Changes => {
                return self.recording.measure(now, &self.observed.values);
            }
            _ => return,
        };
        if !flags.contains(SystemState::MOVING) {
            self.motion.rested();
        }
        self.recording.flags(now, before, flags);
        self.notice_restart(now, before, flags);
        self.notice_foreign_motion(now, before, flags);
        self.notice_overdrive(now, before, flags);
        if missed {
            self.set_up_again(now);
        }
        let mut origin = Origin {
            ids: &mut self.ids,
            unannounced: self.link.unannounced && self.config.rules.fast_stop_on_disconnect,
        };
        match self.latch.take_flags(now, flags, &mut origin) {
            Some(LatchChange::Seen { overtaken }) => {
                if let Some(token) = overtaken {
                    self.link.withdraw(token);
                }
                let cause = self.latch.current().map_or(FastStopCause::Unknown, |latch| latch.cause);
                tracing::warn!(gripper = %self.config.name, cause = cause.name(), "device in FAST STOP");
                self.record_fast_stop(now, FastStopStep::Latched, None);
                self.abort_for_latch(now);
                self.link.expect_aborts(now);
            }
            Some(LatchChange::Confirmed) => {
                tracing::info!(gripper = %self.config.name, "FAST STOP confirmed");
                // The reply to the FAST STOP may have been lost.
                self.observed.values.changed_at = Some(now.instant);
                self.record_fast_stop(now, FastStopStep::Confirmed, None);
                self.link.expect_aborts(now);
            }
            Some(LatchChange::Cleared) => tracing::info!(gripper = %self.config.name, "FAST STOP cleared"),
            Some(LatchChange::Forgotten) => {
                tracing::warn!(
                    gripper = %self.config.name,
                    "device no longer in FAST STOP, although not acknowledged here: stopping it again"
                );
            }
            None => {}
        }
    }

    /// Whether a value would cause an action that a late datagram must not cause alone: it shows a lost reference, a FAST
    /// STOP that nobody requested, or a lost part. The next value of the same getter then decides.
    fn needs_second_look(&mut self, now: Now, data: &Data) -> bool {
        let alarm = match data {
            Data::SystemState(flags) => {
                let has_lost = self.observed.has(SystemState::REFERENCED) && !flags.contains(SystemState::REFERENCED);
                let is_stopped = self.latch.id().is_none() && flags.contains(SystemState::FAST_STOP);
                has_lost || is_stopped
            }
            Data::GripperState(state) => {
                *state == GripperState::PartLost && self.observed.last_state() != Some(GripperState::PartLost)
            }
            _ => return false,
        };
        let is_first = alarm && self.observed.doubt(data);
        if is_first {
            // A device that sends only changes does not repeat the value by itself.
            let getter = match data {
                Data::SystemState(_) => id::GET_SYSTEM_STATE,
                _ => id::GET_GRIPPER_STATE,
            };
            let rules = self.update_rules();
            if let Some(command) = automatic_updates::switch_on(getter, rules, self.link.properties.bytes_per_second) {
                let _ = self.link.submit(now, command, Purpose::Upkeep);
            }
        }
        is_first
    }

    /// Notices a restart of the device by the loss of its reference, unless the fingers are being homed by this gateway
    /// or another program. On a transport without connections, the only other signs of a restart are silence and missed
    /// updates.
    fn notice_restart(&mut self, now: Now, before: Option<SystemState>, flags: SystemState) {
        let was_referenced = before.is_some_and(|before| before.contains(SystemState::REFERENCED));
        let homes = flags.contains(SystemState::MOVING) || self.motion.is_homing();
        if !was_referenced || flags.contains(SystemState::REFERENCED) || homes {
            return;
        }
        tracing::warn!(gripper = %self.config.name, "device restarted: reference lost");
        self.recording.device(now, DeviceEvent::Restarted);
        if self.link.is_up() {
            self.link.close = Some(Close::Restarted);
        }
    }

    /// Notices the beginning of a motion that no command explains. A client's script, another program or a hand can
    /// cause it.
    fn notice_foreign_motion(&mut self, now: Now, before: Option<SystemState>, flags: SystemState) {
        if !flags.contains(SystemState::MOVING) {
            return self.scripts.rested();
        }
        let begins = before.is_some_and(|before| !before.contains(SystemState::MOVING));
        // Scripts are checked before a held part, since a script can release it. After a part is lost, the fingers
        // close further by themselves.
        if !begins || self.motion.is_sent() || self.is_part_lost() || self.script_moves(now) {
            return;
        }
        if let Some(id) = self.motion.takes_late_motion(now.instant) {
            tracing::warn!(gripper = %self.config.name, "late motion stopped: its client was told that its result is unknown");
            return self.link.send_stop(now, OwnStop::new(Some(id)));
        }
        let holds = self.observed.last_state() == Some(GripperState::Holding);
        if !holds && !self.motion.may_move(now.instant) {
            tracing::warn!(gripper = %self.config.name, "fingers moving without a command of this gateway");
            self.recording.device(now, DeviceEvent::ForeignMotion);
        }
    }

    /// Reads the force limit after Overdrive Mode was switched, since leaving it reduces the limit (`fw4-en 3.3.8`).
    fn notice_overdrive(&mut self, now: Now, before: Option<SystemState>, flags: SystemState) {
        let changed = before.unwrap_or(flags).symmetric_difference(flags);
        if changed.contains(SystemState::OVERDRIVE_MODE) && self.link.is_up() {
            // If this fails, the next setup compares the limit.
            let _ = self.link.submit(now, Command::GetForceLimit, Purpose::ForceLimit);
        }
    }

    fn take_end(&mut self, now: Now, token: Token, purpose: Purpose, end: End) {
        match purpose {
            Purpose::Setup => {
                if self.link.setup_ended(token, end) && self.drain.is_none() {
                    self.continue_setup(now);
                }
            }
            // The values come as updates, and a drain looks for the last requests that remain.
            Purpose::Upkeep | Purpose::LastRequest => {}
            Purpose::Unconfirmed(setting) => self.unconfirmed_ended(now, setting, end),
            Purpose::Temperature => match end {
                End::Reply(Reply::Success(data)) => self.observed.take(now.instant, &data),
                End::Reply(Reply::Status(status)) => {
                    self.observed.lose(id::GET_TEMPERATURE, Missing::Refused(status));
                    self.reads.forget();
                }
                End::Invalid(_) => self.observed.lose(id::GET_TEMPERATURE, Missing::Unreadable),
                End::Unanswered { .. } | End::NoResult { .. } => {}
            },
            Purpose::ForceLimit => {
                if let End::Reply(Reply::Success(data @ Data::ForceLimit(found))) = end
                    && self.settings.wanted.force_limit.is_some_and(|wanted| wanted != found)
                {
                    self.reads.forget();
                    self.note_setting(&data);
                    self.recording.changed_by_device(now, &data);
                }
            }
            Purpose::FastStop => {
                let answered = matches!(end, End::Reply(_));
                self.latch.ended(token, answered);
                if answered {
                    self.read_awaited_flags(now);
                }
            }
            Purpose::FaultCheck => self.fault_checked(now, token, end),
            Purpose::Acknowledge => {
                let result = match end {
                    End::Reply(Reply::Success(_)) => {
                        self.observed.acknowledged();
                        Ok(())
                    }
                    end => Err(self.rejection_of("AcknowledgeFastStop", end)),
                };
                self.latch.acknowledge_ended(now.instant, token, result);
                self.read_awaited_flags(now);
            }
            Purpose::Force(id, force) => self.force_ended(now, id, force, end),
            Purpose::ServoForce(force, client) => self.servo_force_ended(now, force, client, &end),
            Purpose::Motion(id) => self.motion_ended(now, id, end),
            Purpose::Stop(id) => self.stop_ended(now, id, end),
            Purpose::OwnStop(stop) => self.own_stop_ended(now, stop, &end),
            Purpose::Exchange(exchange) => {
                self.reads.forget();
                if self.is_script(&exchange.command) {
                    self.scripts.request_ended(now.instant, exchange.lease.as_ref(), &end);
                }
                self.take_exchange_end(now, exchange, end);
            }
            Purpose::Read(id) => self.read_ended(now, id, end),
        }
    }

    /// Reads the flags at once if they decide about the FAST STOP and the device sends them only when they change.
    /// Flags that confirm a repeated FAST STOP, or that outlast an acknowledgement, do not change. Those that changed
    /// before an acknowledgement failed do not change again.
    fn read_awaited_flags(&mut self, now: Now) {
        let is_on_change = self.config.rules.updates.mode == UpdateMode::Changes;
        if is_on_change && self.latch.id().is_some() {
            // A full queue counts as no reply: the flags are polled later.
            let _ = self.link.submit(now, self.read_flags(), Purpose::Upkeep);
        }
    }

    fn take_exchange_end(&mut self, now: Now, exchange: Exchange, end: End) {
        match end {
            End::Reply(Reply::Success(data)) => self.exchange_succeeded(now, exchange, data),
            // Cleared soft limits read back as not available (`fw4-en 3.3.6`), which is success.
            End::Reply(Reply::Status(Status::E_NOT_AVAILABLE))
                if matches!(exchange.setter, Some(Command::ClearSoftLimits)) =>
            {
                self.settings.note_no_soft_limits();
                self.persist_settings();
                self.recording.setting(now, &exchange.client, SettingChange::SoftLimitsCleared);
                self.answers.add(exchange.answer, Ok(Data::None));
            }
            end => {
                let command = super::name_of(&exchange.command);
                self.note_unanswered(now, &exchange.command, &exchange.client, &end);
                self.stop_script(now, &exchange.command, &end);
                // If a setting can't be read back, the reply has the value as sent.
                let result = match exchange.setter.as_ref().and_then(as_read_back) {
                    Some(data) => {
                        self.note_setting(&data);
                        self.recording.set(now, &exchange.client, &data);
                        Ok(data)
                    }
                    None => Err(self.rejection_of(command, end)),
                };
                self.answers.add(exchange.answer, result);
            }
        }
    }
}

/// Data that reading back a setter's value would return if the device took the value unchanged.
fn as_read_back(setter: &Command) -> Option<Data> {
    Some(match setter {
        Command::SetAcceleration(acceleration) => Data::Acceleration(*acceleration),
        Command::SetForceLimit(force) => Data::ForceLimit(*force),
        Command::SetSoftLimits(limits) => Data::SoftLimits(*limits),
        Command::SetDeviceTag(tag) => Data::DeviceTag(tag.clone()),
        _ => return None,
    })
}
