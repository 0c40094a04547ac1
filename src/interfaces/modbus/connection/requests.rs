//! Requests: reads and writes of registers, and their responses.

use std::collections::BTreeSet;
use std::time::Duration;

use bytes::Bytes;
use tokio_modbus::Request;
use tokio_modbus::prelude::ExceptionCode;

use super::super::adu::{self, Header};
use super::super::image::{Image, WriteError, number_of};
use super::super::registers::{FAST_STOP_AT, GATEWAY_UNITS, INPUTS_AT, UnitRegisters};
use super::super::status::{self, GripperView};
use super::pending::{ReplyAfterWrite, Target, Unanswered};
use super::{ConnectionEnd, ModbusConnection};
use crate::gripper::{Handle, Now};
use crate::model::clock;
use crate::model::{Name, State};
use crate::operations::Code;

/// Most registers in one read (Modbus Application Protocol V1.1b3, 6.3).
const MAX_READ: u16 = 125;

/// Time that the response to a command waits for an early refusal. A slow disk delays the admission, but not the
/// response.
const ANSWERED_WITHIN: Duration = Duration::from_millis(10);

/// Vendor name in the device identification.
const VENDOR: &str = "WSG Gateway";

impl From<WriteError> for ExceptionCode {
    fn from(error: WriteError) -> Self {
        match error {
            WriteError::Address => Self::IllegalDataAddress,
            WriteError::Value => Self::IllegalDataValue,
        }
    }
}

impl ModbusConnection {
    /// Performs a request. Returns the data of the response, or `None` if the response waits for a command.
    pub(super) fn perform(&mut self, header: Header, request: Bytes) -> Result<Option<Vec<u8>>, ExceptionCode> {
        let target = self.target(header.unit)?;
        match adu::request(request)? {
            Request::ReadHoldingRegisters(address, count) => self.holding(&target, address, count).map(Some),
            Request::ReadInputRegisters(address, count) => {
                let unit = self.registers(&target);
                let data = read(count, |count| unit.inputs(address, count))?;
                self.saw(&target, unit.seen);
                Ok(Some(data))
            }
            Request::WriteSingleRegister(address, word) => {
                self.write(header, target, (address, &[word]), ReplyAfterWrite::Echo { address, word })
            }
            Request::WriteMultipleRegisters(address, words) => {
                // A request of 253 bytes has fewer than 127 registers.
                let word = words.len() as u16;
                self.write(header, target, (address, &words), ReplyAfterWrite::Echo { address, word })
            }
            Request::ReadWriteMultipleRegisters(address, count, write_address, words) => {
                // Nothing is written if the read range is invalid. The client has read nothing yet.
                read(count, |count| UnitRegisters::ZERO.holding(address, count))?;
                self.write(header, target, (write_address, &words), ReplyAfterWrite::Read { address, count })
            }
            Request::ReadDeviceIdentification(code, first) => {
                let product = match &target {
                    Target::Gateway => self.context.gateway.name.as_str(),
                    Target::Gripper(gripper) => gripper.name().as_str(),
                };
                let objects = [VENDOR, product, env!("CARGO_PKG_VERSION")];
                adu::identification(code, first, &objects).map(Some).ok_or(ExceptionCode::IllegalDataAddress)
            }
            _ => Err(ExceptionCode::IllegalFunction),
        }
    }

    /// Performs only the FAST STOPs of a request whose client is gone, one for each unit.
    pub(super) fn perform_fast_stops(&mut self, header: Header, request: Bytes, stopped: &mut BTreeSet<Option<Name>>) {
        let Ok(target) = self.target(header.unit) else { return };
        let Some((address, words)) = adu::written(request) else { return };
        let now = clock::instant();
        let stops = self.image(&target).write(now, address, &words).is_ok_and(|written| written.fast_stop);
        if stops && stopped.insert(target.gripper()) {
            self.fast_stop(&target);
        }
    }

    fn target(&self, unit: u8) -> Result<Target, ExceptionCode> {
        if GATEWAY_UNITS.contains(&unit) {
            return Ok(Target::Gateway);
        }
        let settings = self.settings.now();
        let gripper = settings.units.get(&unit).and_then(|name| self.context.gateway.grippers.get(name));
        gripper.map(Target::Gripper).ok_or(ExceptionCode::GatewayPathUnavailable)
    }

    pub(super) fn image(&mut self, target: &Target) -> &mut Image {
        self.images.entry(target.gripper()).or_insert_with(|| Image::new(clock::instant()))
    }

    fn registers(&mut self, target: &Target) -> UnitRegisters {
        let heartbeat = self.context.heartbeat();
        match target {
            Target::Gateway => {
                let states: Vec<_> = self.context.gateway.grippers.all().iter().map(Handle::state).collect();
                let inputs = status::of_gateway(states.iter().map(AsRef::<State>::as_ref), heartbeat, Now::read());
                UnitRegisters { outputs: self.image(target).outputs(), inputs, seen: 0 }
            }
            Target::Gripper(gripper) => {
                let is_holder = self.held_token(gripper).is_some();
                let subject = self.client.subject.clone();
                let is_claiming = self.claiming.contains_key(gripper.name());
                let image = self.image(target);
                let state = image.read(|| gripper.state());
                // The lease of a motion that has just taken it is kept a moment later.
                let holds_lease = is_holder || is_claiming && state.lease_holder.as_deref() == Some(&*subject);
                let is_reserved = state.reserved_for.as_deref() == Some(&*subject);
                let now = clock::instant();
                let view = GripperView { image, holds_lease, is_reserved, heartbeat, now };
                let inputs = status::of_gripper(&state, view);
                let seen = state.latch.as_ref().map_or(0, number_of);
                UnitRegisters { outputs: image.outputs(), inputs, seen }
            }
        }
    }

    fn holding(&mut self, target: &Target, address: u16, count: u16) -> Result<Vec<u8>, ExceptionCode> {
        let unit = self.registers(target);
        let data = read(count, |count| unit.holding(address, count))?;
        if address >= INPUTS_AT {
            self.saw(target, unit.seen);
        }
        Ok(data)
    }

    /// Notes that the client reads the input registers, with this FAST STOP.
    fn saw(&mut self, target: &Target, fast_stop: u16) {
        self.image(target).saw(fast_stop);
    }

    fn write(
        &mut self,
        header: Header,
        target: Target,
        (address, words): (u16, &[u16]),
        reply: ReplyAfterWrite,
    ) -> Result<Option<Vec<u8>>, ExceptionCode> {
        let is_writable = matches!(target, Target::Gripper(_)) || (address, words.len()) == (FAST_STOP_AT, 1);
        if !is_writable {
            return Err(ExceptionCode::IllegalDataAddress);
        }
        let now = self.heard;
        let written = self.image(&target).write(now, address, words)?;
        if written.fast_stop {
            self.fast_stop(&target);
        }
        if let (Some((number, order)), Target::Gripper(gripper)) = (written.command, &target) {
            self.order(gripper, number, order);
            if !self.image(&target).has_answer(number) {
                let until = now + ANSWERED_WITHIN;
                self.unanswered = Some(Unanswered { header, target, number, until, reply });
                return Ok(None);
            }
            check_value(self.image(&target), number)?;
        }
        self.reply(&target, reply).map(Some)
    }

    fn reply(&mut self, target: &Target, reply: ReplyAfterWrite) -> Result<Vec<u8>, ExceptionCode> {
        match reply {
            ReplyAfterWrite::Echo { address, word } => Ok(adu::echo(address, word)),
            ReplyAfterWrite::Read { address, count } => self.holding(target, address, count),
        }
    }

    pub(super) async fn answer_if_ended(&mut self) -> Result<(), ConnectionEnd> {
        let Some((target, number)) = self.unanswered.as_ref().map(|one| (one.target.clone(), one.number)) else {
            return Ok(());
        };
        if self.image(&target).has_answer(number) { self.answer().await } else { Ok(()) }
    }

    pub(super) async fn answer(&mut self) -> Result<(), ConnectionEnd> {
        let Some(Unanswered { header, target, number, reply, .. }) = self.unanswered.take() else { return Ok(()) };
        let response = check_value(self.image(&target), number).and_then(|()| self.reply(&target, reply));
        match response {
            Ok(data) => self.send(header, Ok(&data)).await,
            Err(exception) => self.send(header, Err(exception)).await,
        }
    }
}

/// Returns the data of a response with registers.
fn read(count: u16, registers: impl FnOnce(u16) -> Option<Vec<u16>>) -> Result<Vec<u8>, ExceptionCode> {
    if !(1..=MAX_READ).contains(&count) {
        return Err(ExceptionCode::IllegalDataValue);
    }
    registers(count).map(|words| adu::registers(&words)).ok_or(ExceptionCode::IllegalDataAddress)
}

/// Returns the exception of a command that was refused because of its values.
fn check_value(image: &Image, number: u64) -> Result<(), ExceptionCode> {
    match image.problem_of(number) {
        Some(Code::Malformed | Code::OutOfRange | Code::NotFound) => Err(ExceptionCode::IllegalDataValue),
        _ => Ok(()),
    }
}
