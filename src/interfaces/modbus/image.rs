//! The registers of one connection at one unit: the written values, and the progress of its commands.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Instant;

use serde::Deserialize;

use super::commands::CommandRegisters;
use super::fieldbus::{FieldbusFlags, FieldbusRegisters};
use super::order::{ModbusOrder, OutOfRange};
use super::registers::{COMMAND_AT, FLAGS_AT, Outputs};
use crate::gripper::Ticket;
use crate::model::{CommandReport, LatchFields, Outcome, Phase, State};
use crate::operations::Code;
use crate::wsg::Status;

/// Reason why registers cannot be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WriteError {
    /// A register does not exist, or cannot be written.
    Address,
    Value,
}

impl From<OutOfRange> for WriteError {
    fn from(_: OutOfRange) -> Self {
        Self::Value
    }
}

/// Effect of a write.
#[derive(Debug, Default, PartialEq)]
pub(super) struct WriteEffect {
    /// Whether a FAST STOP was requested.
    pub fast_stop: bool,
    /// A command to execute, with its number in this image.
    pub command: Option<(u64, ModbusOrder)>,
}

/// The client's last command.
#[derive(Debug)]
pub(super) enum ImageCommand {
    None,
    /// The command was received, and is not admitted yet.
    Requested,
    Admitted(Ticket),
    Ended(Ended),
}

/// Result of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Ended {
    pub is_ok: bool,
    /// Absent for a command without a motion or a Stop.
    pub outcome: Option<Outcome>,
    pub problem: Option<Code>,
    /// Status code of the device.
    pub status: u16,
}

/// Fields of a reply that describe the end of a command.
#[derive(Debug, Deserialize)]
struct EndedReply {
    outcome: Option<Outcome>,
    status_code: Option<u16>,
}

/// Measurements of the last grip that has ended.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LastGrip {
    pub contact_width_mm: Option<f32>,
    pub peak_force_n: Option<f32>,
}

/// The registers of one connection at one unit.
#[derive(Debug)]
pub(super) struct Image {
    outputs: Outputs,
    /// Whether the flags of the fieldbus map were 0 once.
    is_fieldbus_prepared: bool,
    /// Whether the command of the gateway map was 0 once.
    is_prepared: bool,
    /// Counter of the last command that was taken up.
    counter: u16,
    /// Number of the last command in this image.
    number: u64,
    command: ImageCommand,
    /// Numbers of the JOG commands whose flags are set, without refused ones: at most one for each flag.
    jogs: BTreeSet<u64>,
    grip: LastGrip,
    /// Number of the FAST STOP that the client has read; 0 for none.
    seen: u16,
    /// Time of the last change of the heartbeat, or of the last command.
    alive_at: Instant,
}

impl Ended {
    const OK: Self = Self { is_ok: true, outcome: None, problem: None, status: 0 };

    /// The end of a command that was refused, or whose effect may be unknown because no valid reply came.
    pub(super) fn refused(problem: Code) -> Self {
        let status = match problem {
            Code::Malformed | Code::OutOfRange | Code::NotFound => Status::E_RANGE_ERROR,
            Code::DeviceTimeout | Code::DeviceProtocol => Status::E_TIMEOUT,
            _ => Status::E_ACCESS_DENIED,
        };
        Self { is_ok: false, outcome: None, problem: Some(problem), status: status.code() }
    }

    /// Whether the command was refused, so that it has no effect.
    fn was_refused(self) -> bool {
        self.problem.is_some() && self.outcome.is_none() && self.status != Status::E_TIMEOUT.code()
    }

    /// The end of a command without a motion, or of a Stop without an effect.
    pub(super) fn done() -> Self {
        Self::OK
    }

    /// The end that a reply in JSON describes: of a Stop, or of another operation.
    pub(super) fn of_reply(reply: &str) -> Self {
        match serde_json::from_str(reply) {
            Ok(EndedReply { outcome: Some(outcome), status_code }) => Self::with(outcome, None, status_code),
            _ => Self::done(),
        }
    }

    fn of(command: &CommandReport) -> Self {
        Self::with(command.outcome.unwrap_or(Outcome::Unknown), command.code, command.status_code)
    }

    fn with(outcome: Outcome, problem: Option<Code>, status_code: Option<u16>) -> Self {
        let without_status = match outcome {
            _ if outcome.is_ok() => Status::E_SUCCESS,
            Outcome::Refused => Status::E_ACCESS_DENIED,
            Outcome::Aborted => Status::E_CMD_ABORTED,
            // A status of refused commands would say that nothing moved.
            _ => Status::E_TIMEOUT,
        };
        let status = status_code.unwrap_or(without_status.code());
        Self { is_ok: outcome.is_ok(), outcome: Some(outcome), problem, status }
    }
}

impl Image {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            outputs: Outputs::ZERO,
            is_fieldbus_prepared: false,
            is_prepared: false,
            counter: 0,
            number: 0,
            command: ImageCommand::None,
            jogs: BTreeSet::new(),
            grip: LastGrip::default(),
            seen: 0,
            alive_at: now,
        }
    }

    /// Writes registers, and returns the requested FAST STOP and command.
    ///
    /// # Errors
    /// [`WriteError`]. After [`WriteError::Value`] the registers are written, and the command has ended.
    pub(super) fn write(&mut self, now: Instant, address: u16, words: &[u16]) -> Result<WriteEffect, WriteError> {
        let flags = self.flags();
        let before = self.commands();
        self.outputs.set(address, words).ok_or(WriteError::Address)?;
        let written = address..address.saturating_add(words.len() as u16);
        self.is_fieldbus_prepared |= written.contains(&FLAGS_AT) && self.flags().is_empty();
        let after = self.commands();
        self.is_prepared |= written.contains(&COMMAND_AT) && after.command == 0;
        if after.heartbeat != before.heartbeat {
            self.alive_at = now;
        }
        let is_pressed = before.fast_stop == 0 && after.fast_stop != 0;
        let fast_stop = is_pressed || self.flags().fast_stop_since(flags);
        let of_fieldbus = self.fieldbus_order(flags).filter(|_| !fast_stop);
        let order = match self.gateway_order(after) {
            Err(wrong) => {
                self.begin(now);
                self.command = ImageCommand::Ended(Ended::refused(Code::OutOfRange));
                // A FAST STOP must not be lost because of a wrong command beside it.
                return if fast_stop { Ok(WriteEffect { fast_stop, command: None }) } else { Err(wrong.into()) };
            }
            Ok(order) => order.or(of_fieldbus),
        };
        let command = order.and_then(|order| self.take_up(now, order));
        Ok(WriteEffect { fast_stop, command })
    }

    /// Whether a heartbeat supervises the client, and the time of its last sign of life.
    pub(super) fn alive_at(&self) -> Option<Instant> {
        (self.commands().heartbeat != 0).then_some(self.alive_at)
    }

    /// Takes the admission of a command, unless there is a newer one.
    pub(super) fn admitted(&mut self, number: u64, ticket: Ticket) {
        if number == self.number {
            self.command = ImageCommand::Admitted(ticket);
        }
    }

    /// Takes the end of a command, unless there is a newer one.
    pub(super) fn ended(&mut self, number: u64, ended: Ended) {
        if ended.was_refused() {
            self.jogs.remove(&number);
        }
        if number == self.number {
            self.command = ImageCommand::Ended(ended);
        }
    }

    /// Whether this command was admitted or has ended, or a newer one has replaced it.
    pub(super) fn has_answer(&self, number: u64) -> bool {
        number != self.number || !matches!(self.command, ImageCommand::Requested)
    }

    /// Problem with which this command has ended, if it has.
    pub(super) fn problem_of(&self, number: u64) -> Option<Code> {
        match &self.command {
            ImageCommand::Ended(ended) if number == self.number => ended.problem,
            _ => None,
        }
    }

    /// Reads the state for the client, and takes the end of the last command once the state shows it, too.
    pub(super) fn read(&mut self, state: impl FnOnce() -> Arc<State>) -> Arc<State> {
        let ended = match &self.command {
            ImageCommand::Admitted(ticket) => Some(ticket.now()).filter(|command| command.phase == Phase::Done),
            _ => None,
        };
        // A state that is read after the end can be older than the end, but not than the motion.
        let state = state();
        if let Some(command) = ended.filter(|command| state.command_id != Some(command.id)) {
            self.command = ImageCommand::Ended(Ended::of(&command));
            if command.kind.is_grip() {
                let CommandReport { contact_width_mm, peak_force_n, .. } = command;
                self.grip = LastGrip { contact_width_mm, peak_force_n };
            }
        }
        state
    }

    /// Notes that the client reads the input registers, with this FAST STOP.
    pub(super) fn saw(&mut self, fast_stop: u16) {
        self.seen = fast_stop;
    }

    pub(super) fn outputs(&self) -> Outputs {
        self.outputs
    }

    pub(super) fn counter(&self) -> u16 {
        self.counter
    }

    pub(super) fn command(&self) -> &ImageCommand {
        &self.command
    }

    pub(super) fn grip(&self) -> LastGrip {
        self.grip
    }

    pub(super) fn is_prepared(&self) -> bool {
        self.is_prepared
    }

    /// Number of the FAST STOP that the client has read; 0 for none.
    pub(super) fn seen(&self) -> u16 {
        self.seen
    }

    fn commands(&self) -> CommandRegisters {
        self.outputs.gateway.into()
    }

    fn flags(&self) -> FieldbusFlags {
        FieldbusRegisters::from(self.outputs.fieldbus).flags
    }

    fn fieldbus_order(&mut self, before: FieldbusFlags) -> Option<ModbusOrder> {
        let outputs = FieldbusRegisters::from(self.outputs.fieldbus);
        let is_jogging = !self.jogs.is_empty();
        if outputs.flags.ends_jog_since(before) {
            self.jogs.clear();
        }
        outputs.order_since(before, is_jogging).filter(|_| self.is_fieldbus_prepared)
    }

    fn gateway_order(&mut self, outputs: CommandRegisters) -> Result<Option<ModbusOrder>, OutOfRange> {
        if !self.is_prepared || outputs.counter == self.counter {
            return Ok(None);
        }
        self.counter = outputs.counter;
        outputs.order()
    }

    fn take_up(&mut self, now: Instant, order: ModbusOrder) -> Option<(u64, ModbusOrder)> {
        let number = self.begin(now);
        if order.is_blocked_by_fast_stop() && self.requests_fast_stop() {
            self.command = ImageCommand::Ended(Ended::refused(Code::FastStop));
            return None;
        }
        if matches!(order, ModbusOrder::Jog { .. }) {
            self.jogs.insert(number);
        }
        Some((number, order))
    }

    /// Whether the client still requests a FAST STOP.
    fn requests_fast_stop(&self) -> bool {
        self.commands().fast_stop != 0 || self.flags().has_fast_stop()
    }

    fn begin(&mut self, now: Instant) -> u64 {
        self.number += 1;
        self.command = ImageCommand::Requested;
        // A client that commands is alive, even if its heartbeat begins only now.
        self.alive_at = now;
        self.number
    }
}

/// Number of a FAST STOP, from 1 to 65535. It differs from the number of the FAST STOP before.
pub(super) fn number_of(latch: &LatchFields) -> u16 {
    (latch.epoch % u64::from(u16::MAX)) as u16 + 1
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Counter and command of the gateway map.
    const COUNTER: u16 = 100;
    const COMMAND: u16 = 101;
    const HEARTBEAT: u16 = 108;
    const FAST_STOP: u16 = 110;
    /// Commands.
    const STOP: u16 = 5;
    const ACKNOWLEDGE: u16 = 6;

    fn image() -> (Image, Instant) {
        let now = Instant::now();
        (Image::new(now), now)
    }

    fn command(image: &mut Image, address: u16, words: &[u16]) -> Option<ModbusOrder> {
        image.write(Instant::now(), address, words).unwrap().command.map(|(_, order)| order)
    }

    #[test]
    fn command_is_executed_once_for_each_counter() {
        let (mut image, _) = image();
        assert_eq!(command(&mut image, COUNTER, &[7, 0]), None);
        assert_eq!(image.counter(), 7);
        assert_eq!(command(&mut image, COUNTER, &[8, STOP]), Some(ModbusOrder::Stop));
        assert_eq!(command(&mut image, COUNTER, &[8, STOP]), None, "repeated");
        assert_eq!(command(&mut image, COMMAND, &[1]), None, "the counter has not changed");
        assert_eq!(command(&mut image, COUNTER, &[9, STOP]), Some(ModbusOrder::Stop));
        assert_eq!(image.counter(), 9);
    }

    #[test]
    fn stale_commands_of_a_new_connection_are_not_executed() {
        let (mut image, _) = image();
        assert_eq!(command(&mut image, COUNTER, &[8, STOP]), None);
        assert_eq!(command(&mut image, COUNTER, &[9, STOP]), None);
        assert!(!image.is_prepared() && image.counter() == 0);
        assert_eq!(command(&mut image, 0, &[0x1000, 0, 0, 0]), None, "the flag was not seen to rise");
        assert_eq!(command(&mut image, 0, &[0, 0, 0, 0]), None);
        assert_eq!(command(&mut image, 0, &[0x1000, 0, 0, 0]), Some(ModbusOrder::StopOrAcknowledge));
        assert_eq!(command(&mut image, COMMAND, &[0]), None);
        assert!(image.is_prepared());
        assert_eq!(command(&mut image, COUNTER, &[10, STOP]), Some(ModbusOrder::Stop));
    }

    #[test]
    fn fast_stop_needs_no_preparation_and_outlives_a_wrong_command() {
        let (mut image, now) = image();
        let written = image.write(now, FAST_STOP, &[1]).unwrap();
        assert_eq!(written, WriteEffect { fast_stop: true, command: None });
        assert_eq!(image.write(now, FAST_STOP, &[2]).unwrap(), WriteEffect::default(), "no rising edge");
        let flag = image.write(now, 0, &[0x2100, 0, 0, 0]).unwrap();
        assert_eq!(flag, WriteEffect { fast_stop: true, command: None }, "FAST STOP wins over MOVE");
        image.write(now, COMMAND, &[0]).unwrap();
        image.write(now, FAST_STOP, &[0]).unwrap();
        let wrong = image.write(now, COUNTER, &[1, 99, 0, 0, 0, 0, 0, 0, 0, 0, 1]).unwrap();
        assert_eq!(wrong, WriteEffect { fast_stop: true, command: None });
        assert_eq!(image.problem_of(image.number), Some(Code::OutOfRange));
    }

    #[test]
    fn nothing_is_acknowledged_while_fast_stop_is_requested() {
        let (mut image, now) = image();
        image.write(now, COMMAND, &[0]).unwrap();
        let pressed = [1, ACKNOWLEDGE, 0, 0, 0, 0, 0, 0, 0, 42, 1];
        assert_eq!(image.write(now, COUNTER, &pressed).unwrap(), WriteEffect { fast_stop: true, command: None });
        assert_eq!(image.problem_of(image.number), Some(Code::FastStop));
        let released = [2, ACKNOWLEDGE, 0, 0, 0, 0, 0, 0, 0, 42, 0];
        assert_eq!(command(&mut image, COUNTER, &released), Some(ModbusOrder::Acknowledge { number: 42 }));
    }

    #[test]
    fn unknown_command_is_a_wrong_value() {
        let (mut image, now) = image();
        image.write(now, COMMAND, &[0]).unwrap();
        assert_eq!(image.write(now, COUNTER, &[1, 99]), Err(WriteError::Value));
        assert_eq!((image.counter(), image.problem_of(image.number)), (1, Some(Code::OutOfRange)));
        assert_eq!(image.write(now, 4, &[1]), Err(WriteError::Address));
    }

    #[test]
    fn heartbeat_supervises_while_it_is_not_0() {
        let (mut image, start) = image();
        let later = start + Duration::from_millis(500);
        assert_eq!(image.alive_at(), None);
        image.write(later, HEARTBEAT, &[1]).unwrap();
        assert_eq!(image.alive_at(), Some(later));
        let last = later + Duration::from_millis(500);
        image.write(last, HEARTBEAT, &[1]).unwrap();
        assert_eq!(image.alive_at(), Some(later), "unchanged");
        image.write(last, HEARTBEAT, &[2]).unwrap();
        assert_eq!(image.alive_at(), Some(last));
        image.write(last, HEARTBEAT, &[0]).unwrap();
        assert_eq!(image.alive_at(), None);
    }

    #[test]
    fn command_that_may_have_moved_has_no_status_of_a_refused_one() {
        let status = |outcome| Ended::with(outcome, None, None).status;
        assert_eq!(status(Outcome::Success), Status::E_SUCCESS.code());
        assert_eq!(status(Outcome::Refused), Status::E_ACCESS_DENIED.code());
        assert_eq!(status(Outcome::Aborted), Status::E_CMD_ABORTED.code());
        assert_eq!(status(Outcome::Unknown), Status::E_TIMEOUT.code());
        assert_eq!(Ended::refused(Code::DeviceTimeout).status, Status::E_TIMEOUT.code());
        assert_eq!(Ended::refused(Code::LinkDown).status, Status::E_ACCESS_DENIED.code());
    }

    #[test]
    fn result_of_an_older_command_is_ignored() {
        let (mut image, now) = image();
        image.write(now, COMMAND, &[0]).unwrap();
        let (first, _) = image.write(now, COUNTER, &[1, STOP]).unwrap().command.unwrap();
        let (second, _) = image.write(now, COUNTER, &[2, STOP]).unwrap().command.unwrap();
        image.ended(first, Ended::refused(Code::LinkDown));
        assert!(matches!(image.command(), ImageCommand::Requested));
        image.ended(second, Ended::done());
        assert!(matches!(image.command(), ImageCommand::Ended(Ended { is_ok: true, .. })));
    }
}
