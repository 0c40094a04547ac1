//! Admission of clients' requests: checks, commands, exchanges and acknowledgements.

use std::sync::Arc;

use super::super::Now;
use super::super::handle::{ResultSender, Steps, Ticket};
use super::Actor;
use super::link::{Exchange, OwnStop, Purpose};
use super::reads::is_slow_getter;
use super::running::Running;
use model::error::{Conflict, Failure, Invalid, Rejection};
use model::{
    Action, Client, CommandId, CommandReport, FastStopId, LeaseToken, Motion, Outcome, ServoEnd, SettingChange,
    Submission,
};
use wsg::session::{End, Token};
use wsg::{Command, Data, Reply, SystemState, id};

impl Actor {
    /// Admits or rejects a command.
    pub(super) fn admit(&mut self, now: Now, id: CommandId, submission: &Submission) -> Result<Ticket, Rejection> {
        let clamped = submission.client.door.speaks_wsg().then(|| self.clamped(now, submission));
        let submission = clamped.as_ref().unwrap_or(submission);
        let keep = self.lease.keep(now.instant, submission.lease.as_ref()).map(Arc::new);
        let replay = self.commands.replay(now.instant, submission);
        match &submission.action {
            Action::Motion(motion) => {
                if let Some(ticket) = replay? {
                    return Ok(Ticket { _keep: keep, ..ticket });
                }
                let is_streamed = self.is_streamed(motion);
                if !is_streamed {
                    self.commands.check_room(now.instant, submission)?;
                }
                // A request that is refused for another reason is no pause, either.
                let may_steer =
                    if is_streamed { self.streaming.check(now.instant, submission.lease.as_ref()) } else { Ok(()) };
                self.check_motion(now, motion, submission)?;
                may_steer?;
                if is_streamed {
                    self.check_stream_target(now, submission)?;
                }
                self.claim(now, &submission.client, submission.lease.as_ref())?;
                if !is_streamed {
                    self.streaming.resumed(submission.lease.as_ref());
                }
                // A settling motion ends now, with its values so far, before the next one changes them.
                self.end_running(now, false);
                let keep = self.lease.keep(now.instant, submission.lease.as_ref()).map(Arc::new);
                let ticket = self.enter(now, id, submission);
                if !matches!(motion, Motion::Custom(_)) {
                    self.recording.start_measuring(id, motion, self.settings.known_serial);
                }
                self.motion.running = Some(Running::new(now.instant, id, motion.clone(), is_streamed));
                if is_streamed {
                    // A streamed command does not wait for a record.
                    self.motion.let_run();
                    self.commands.recorded(id);
                }
                Ok(Ticket { _keep: keep, ..ticket })
            }
            Action::Stop => Ok(Ticket { _keep: keep, ..self.admit_stop(now, id, submission, replay)? }),
        }
    }

    /// Admits a Stop, whatever its request id stands for. If the id stands for a Stop that is under way, another frame
    /// is sent, because a motion may have begun since. If that Stop has ended, this one is a new command without the
    /// id, unless the earlier one succeeded and the fingers stand still.
    fn admit_stop(
        &mut self,
        now: Now,
        id: CommandId,
        submission: &Submission,
        replay: Result<Option<Ticket>, Conflict>,
    ) -> Result<Ticket, Rejection> {
        let is_moving = self.is_moving(now.instant);
        if let Ok(Some(ticket)) = &replay
            && ticket.now().outcome == Some(Outcome::Success)
            && !is_moving
            && !self.servo.is_open()
        {
            return Ok(ticket.clone());
        }
        self.streaming.stopped(now.instant);
        self.end_servo(now, ServoEnd::Stop);
        if self.motion.is_streamed() {
            self.streaming.watch_after_stop(now.instant);
        }
        // An unwritten script would move the fingers after the Stop.
        self.withdraw_scripts(&Failure::StoppedFirst { command: "the custom command" }.into(), |_| true);
        let without_id;
        let submission = match replay {
            Ok(None) => submission,
            Ok(Some(ticket)) if ticket.now().outcome.is_none() => {
                self.withdraw_waiting_motion(now);
                self.link.send_stop(now, OwnStop::new(self.motion.mover(now.instant)));
                return Ok(ticket);
            }
            Ok(Some(_)) | Err(_) => {
                without_id = Submission { request_id: None, ..submission.clone() };
                &without_id
            }
        };
        if let Some(ticket) = self.repeated_stop(now, submission) {
            self.link.send_stop(now, OwnStop::new(None));
            return Ok(ticket);
        }
        // An unresponsive device may still receive a Stop, so any link will do.
        if let Err(not_taken) = self.link.submit(now, Command::Stop, Purpose::Stop(id)) {
            return self.join_stop(now, not_taken.0);
        }
        self.withdraw_waiting_motion(now);
        if !is_moving {
            self.note_stop(now, &submission.client, id);
        }
        Ok(self.enter(now, id, submission))
    }

    /// Checks a motion: first the FAST STOP (`fw4-en 3.2.4`) and the lease, then its values, then the state of link and
    /// gripper.
    fn check_motion(&self, now: Now, motion: &Motion, submission: &Submission) -> Result<(), Rejection> {
        let referenced = self.observed.has(SystemState::REFERENCED);
        let width = self.observed.values.width_mm(now.instant);
        self.check_latch()?;
        self.check_claim(now, &submission.client, submission.lease.as_ref())?;
        self.settings.limits(&self.observed).check_motion(motion, width)?;
        self.check_link()?;
        self.check_flags(now)?;
        self.check_moving()?;
        self.recording.check()?;
        self.commands.check_past(now.instant, submission)?;
        if !referenced && !matches!(motion, Motion::Home(_) | Motion::Custom(_)) {
            return Err(Conflict::NotReferenced.into());
        }
        Ok(())
    }

    /// Checks that a motion may start now.
    fn check_moving(&self) -> Result<(), Conflict> {
        self.check_stopped()?;
        self.servo.check()?;
        self.motion.check()
    }

    /// Checks that neither a FAST STOP nor a lost setting forbids all motions.
    pub(super) fn check_stopped(&self) -> Result<(), Conflict> {
        self.check_latch()?;
        self.settings.check()
    }

    fn check_latch(&self) -> Result<(), Conflict> {
        self.latch.id().map_or(Ok(()), |id| Err(Conflict::FastStop { id }))
    }

    /// Clamps the values of a submission to the device's limits, as the device would.
    fn clamped(&self, now: Now, submission: &Submission) -> Submission {
        let action = match &submission.action {
            Action::Motion(motion) => Action::Motion(
                self.settings
                    .limits(&self.observed)
                    .clamp_motion(motion.clone(), self.observed.values.width_mm(now.instant)),
            ),
            Action::Stop => Action::Stop,
        };
        Submission { action, ..submission.clone() }
    }

    fn enter(&mut self, now: Now, id: CommandId, submission: &Submission) -> Ticket {
        let kind = submission.action.kind();
        let is_streamed = matches!(&submission.action, Action::Motion(motion) if self.is_streamed(motion));
        let mut record = CommandReport::admitted(id, self.config.name.clone(), submission, now.wall);
        record.requested.holder = self.lease.holder_by(submission.lease.as_ref()).map(|holder| holder.name.clone());
        if is_streamed {
            let target_mm = self.limited_target(&submission.action).map(|target| target.width_mm);
            self.streaming.count(now, submission, target_mm, &mut self.recording);
        } else {
            tracing::info!(gripper = %self.config.name, command = %id, %kind, client = %submission.client.subject, "command admitted");
            self.recording.admitted(now, &record, submission);
        }
        self.commands.enter(now.instant, record, submission, is_streamed)
    }

    /// Checks and sends a request that moves nothing.
    pub(super) fn exchange(
        &mut self,
        now: Now,
        command: Command,
        client: Client,
        lease: Option<&LeaseToken>,
        (accepted, answer): Steps,
    ) {
        let command = if client.door.speaks_wsg() {
            self.settings.limits(&self.observed).clamp_setting(command)
        } else {
            command
        };
        if let Err(rejection) = self.check_exchange(now, &command, &client, lease) {
            self.answers.add(answer, Err(rejection));
            return;
        }
        // A token without a lease renews nothing.
        let _ = self.lease.renew(now.instant, lease);
        if let Some(data) = self.observed.value(command.id(), now.instant) {
            let values = &self.observed.values;
            if values.changed_at.is_none_or(|changed_at| values.is_newer_than(command.id(), changed_at)) {
                self.answers.add(answer, Ok(data));
            } else {
                self.measure(now, command.id(), answer);
            }
            return;
        }
        if let Some(Command::SetDeviceTag(tag)) = command.typed() {
            match self.settings.tag_writes.begin(now.instant, &tag, self.publication.has_tag(&tag)) {
                Ok(true) => {}
                Ok(false) => return self.answers.add(answer, Ok(Data::DeviceTag(tag))),
                Err(failure) => return self.answers.add(answer, Err(failure.into())),
            }
        }
        tracing::debug!(gripper = %self.config.name, command = super::name_of(&command), client = %client.subject, "exchange");
        if is_slow_getter(&command) {
            return self.read(now, command, answer);
        }
        let script_client = self.is_script(&command).then(|| client.clone());
        let exchange =
            Exchange { command: command.clone(), answer, accepted, setter: None, client, lease: lease.cloned() };
        let is_submitted = self.submit_exchange(now, command, Purpose::Exchange(exchange));
        if let Some(client) = script_client.filter(|_| is_submitted) {
            self.note_script(now, &client, lease);
            self.streaming.left(lease);
        }
    }

    fn check_exchange(
        &self,
        now: Now,
        command: &Command,
        client: &Client,
        lease: Option<&LeaseToken>,
    ) -> Result<(), Rejection> {
        if !self.only_reads(command) {
            self.check_claim(now, client, lease)?;
        }
        self.settings.limits(&self.observed).check_setting(command)?;
        self.check_link()?;
        match command {
            command if command.is_motion() => Err(not_here(command, "use its own operation")),
            Command::Stop | Command::FastStop => Err(not_here(command, "use its own operation")),
            Command::AcknowledgeFastStop => Err(not_here(command, "acknowledge the FAST STOP by its id")),
            Command::DisconnectAnnouncement => Err(not_here(command, "the gateway announces its own disconnects")),
            command if command.id() == id::SET_FORCE_LIMIT => Ok(self.motion.check_force_limit()?),
            Command::Custom(_) if self.is_script(command) && client.door.speaks_wsg() => {
                self.check_flags(now)?;
                self.check_stopped()?;
                self.servo.check()?;
                Ok(self.recording.check()?)
            }
            Command::Custom(_) if self.is_script(command) => {
                Err(not_here(command, "it can move the fingers; submit it as a command"))
            }
            command if id::has_updates(command.id()) && self.observed.value(command.id(), now.instant).is_none() => {
                Err(self.no_value(now, command.id()).into())
            }
            _ => Ok(()),
        }
    }

    /// Whether the command belongs to a script that may move the fingers.
    pub(super) fn is_script(&self, command: &Command) -> bool {
        matches!(command, Command::Custom(_)) && !self.only_reads(command)
    }

    /// Whether the command only reads, so that any client can send it.
    pub(super) fn only_reads(&self, command: &Command) -> bool {
        match command {
            Command::Custom(custom) => self.config.rules.custom_ids.read.contains(&custom.id()),
            command => command.is_read(),
        }
    }

    /// Sends the getter after a setter, or takes the value that was read back.
    pub(super) fn exchange_succeeded(&mut self, now: Now, exchange: Exchange, data: Data) {
        let Exchange { command, answer, setter, client, .. } = exchange;
        let command = command.typed().unwrap_or(command);
        if let Command::OverdriveMode { on } = command {
            self.recording.setting(now, &client, SettingChange::Overdrive { enabled: on });
            self.settings.overdrive.requested(now.instant, on, answer);
            return;
        }
        let getter = match command.id() {
            id::SET_ACCELERATION => Command::GetAcceleration,
            id::SET_FORCE_LIMIT => Command::GetForceLimit,
            id::SET_SOFT_LIMITS | id::CLEAR_SOFT_LIMITS => Command::GetSoftLimits,
            id::SET_DEVICE_TAG => Command::GetDeviceTag,
            _ => {
                if setter.is_some() {
                    self.note_setting(&data);
                    if matches!(data, Data::DeviceTag(_)) {
                        self.settings.tag_writes.read_back(now.instant);
                    }
                    self.recording.set(now, &client, &data);
                } else {
                    self.recording.change(now, &client, &command);
                }
                self.answers.add(answer, Ok(data));
                return;
            }
        };
        self.read_back(now, getter, command, client, answer);
    }

    /// Reads back the value that a setter has set.
    pub(super) fn read_back(
        &mut self,
        now: Now,
        getter: Command,
        setter: Command,
        client: Client,
        answer: ResultSender<Data>,
    ) {
        let command = getter.clone();
        let exchange = Exchange { command, answer, accepted: None, setter: Some(setter), client, lease: None };
        let purpose = Purpose::Exchange(exchange);
        self.submit_exchange(now, getter, purpose);
    }

    /// Returns `false` if the session did not take the request, whose answer is then the rejection.
    fn submit_exchange(&mut self, now: Now, command: Command, purpose: Purpose) -> bool {
        let Err(not_taken) = self.link.submit(now, command, purpose) else { return true };
        if let (rejection, Purpose::Exchange(exchange)) = *not_taken {
            self.answers.add(exchange.answer, Err(rejection));
        }
        false
    }

    /// Notes and persists a value that was read back.
    pub(super) fn note_setting(&mut self, data: &Data) {
        match data {
            Data::Acceleration(_) | Data::ForceLimit(_) | Data::SoftLimits(_) => self.settings.note(data),
            Data::DeviceTag(tag) => {
                self.publication.change_info(|info| info.device_tag = Some(tag.text()));
            }
            _ => return,
        }
        self.persist_settings();
    }

    /// Sends an acknowledgement, if the latch and the link allow it.
    pub(super) fn acknowledge(&mut self, now: Now, id: FastStopId, client: Client, answer: ResultSender<()>) {
        let allowed = self.latch.check_acknowledge(id).map_err(Rejection::from);
        self.send_acknowledge(now, allowed, Some(id), client, answer);
    }

    /// Sends an acknowledgement of a fault without a latch (fw2 3.2.5), if the lease and the link allow it.
    pub(super) fn acknowledge_fault(
        &mut self,
        now: Now,
        client: Client,
        lease: Option<&LeaseToken>,
        answer: ResultSender<()>,
    ) {
        let allowed = self.latch.check_acknowledge_fault(self.observed.shows_fault());
        let allowed = allowed.and_then(|()| Ok(self.check_claim(now, &client, lease)?));
        self.send_acknowledge(now, allowed, None, client, answer);
    }

    fn send_acknowledge(
        &mut self,
        now: Now,
        allowed: Result<(), Rejection>,
        id: Option<FastStopId>,
        client: Client,
        answer: ResultSender<()>,
    ) {
        let allowed = allowed.and_then(|()| Ok(self.check_link()?));
        let sent = allowed.and_then(|()| {
            if id.is_some() {
                return self.submit_acknowledge(now);
            }
            // ERROR can arrive before the flag of the FAST STOP that explains it.
            let submitted = self.link.submit(now, self.read_flags(), Purpose::FaultCheck);
            submitted.map_err(|not_taken| not_taken.0)
        });
        match sent {
            Ok(token) => {
                let id_text = id.map(|id| id.to_string());
                tracing::info!(gripper = %self.config.name, id = id_text, by = %client.subject, "acknowledging");
                self.latch.acknowledge_begun(id, client, token, answer);
            }
            Err(rejection) => self.answers.add(answer, Err(rejection)),
        }
    }

    /// Sends the acknowledgement of a fault, unless the flags have just shown a FAST STOP.
    pub(super) fn fault_checked(&mut self, now: Now, token: Token, end: End) {
        if self.latch.is_checking(token) {
            let sent = match end {
                End::Reply(Reply::Success(_)) => self.submit_acknowledge(now),
                end => Err(self.rejection_of("GetSystemState", end)),
            };
            self.latch.checked(sent);
        }
    }

    /// Submits an acknowledgement to the session. No other place does.
    fn submit_acknowledge(&mut self, now: Now) -> Result<Token, Rejection> {
        let submitted = self.link.submit(now, Command::AcknowledgeFastStop, Purpose::Acknowledge);
        submitted.map_err(|not_taken| not_taken.0)
    }
}

/// Rejection of a request that clients send in another way.
fn not_here(command: &Command, remedy: &str) -> Rejection {
    let detail = format!("{} cannot be sent this way: {remedy}", super::name_of(command));
    Rejection::from(Invalid::Malformed { field: "id", detail })
}
