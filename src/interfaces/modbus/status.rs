//! The input registers.

use std::time::Instant;

use super::image::{Ended, Image, ImageCommand, number_of};
use super::registers::{Inputs, scaled};
use crate::gripper::Now;
use crate::model::{Link, State};
use crate::operations::Code;
use crate::wsg::{Status, SystemState};

/// First of four registers of the gateway's clock: microseconds since 1970 in UTC, the most significant word first.
const CLOCK_AT: usize = 16;

/// Registers of the holder's name.
const NAME_REGISTERS: usize = 16;

/// Bits of the status word.
const READY: u16 = 0;
const BUSY: u16 = 1;
const DONE: u16 = 2;
const OK: u16 = 3;
const NOK: u16 = 4;
const IS_HOLDING: u16 = 5;
const MOVING: u16 = 6;
const REFERENCED: u16 = 7;
const FAULT: u16 = 8;
const FAST_STOP: u16 = 9;
const LEASE_MINE: u16 = 10;
const LEASE_OTHERS: u16 = 11;
const CONNECTED: u16 = 12;
const PREPARED: u16 = 13;
/// A value that the registers show as 0 or as unknown should be known, and is not.
const STALE: u16 = 14;
/// The gripper is reserved for another client, which was lost.
const RESERVED: u16 = 15;

/// Parts of the input registers that depend on the client.
#[derive(Debug, Clone, Copy)]
pub(super) struct GripperView<'a> {
    pub image: &'a Image,
    /// Whether this client holds the lease.
    pub holds_lease: bool,
    /// Whether the gripper is reserved for this client.
    pub is_reserved: bool,
    /// Heartbeat of the gateway.
    pub heartbeat: u16,
    pub now: Instant,
}

/// Returns the input registers of a gripper.
pub(super) fn of_gripper(state: &State, view: GripperView<'_>) -> Inputs {
    Inputs { fieldbus: fieldbus(state, view), gateway: gateway(state, view) }
}

fn fieldbus(state: &State, GripperView { image, now, .. }: GripperView<'_>) -> [u16; 6] {
    let values = &state.values;
    let [high, low] = words(values.flags(now).unwrap_or_default().bits());
    let status = match image.command() {
        ImageCommand::None => Status::E_SUCCESS.code(),
        ImageCommand::Requested | ImageCommand::Admitted(_) => Status::E_CMD_PENDING.code(),
        ImageCommand::Ended(ended) => ended.status,
    };
    let gripper_state = u16::from_be_bytes([values.state_code(now).unwrap_or_default(), 0]);
    [gripper_state, high, low, scaled(values.width_mm(now), 100.0), scaled(values.force_n(now), 100.0), status]
}

fn gateway(state: &State, view: GripperView<'_>) -> [u16; 32] {
    let GripperView { image, heartbeat, now, .. } = view;
    let measured = &state.values;
    let (outcome, problem) = match image.command() {
        ImageCommand::Ended(Ended { outcome, problem, .. }) => (*outcome, *problem),
        _ => (None, None),
    };
    let grip = image.grip();
    let [motion_high, motion_low] = words(state.last_command);
    let values = [
        image.counter(),
        status_word(state, view),
        outcome.map_or(0, |outcome| outcome.code().into()),
        problem.map_or(0, Code::number),
        state.fault_code,
        measured.state_code(now).unwrap_or_default().into(),
        scaled(measured.width_mm(now), 100.0),
        scaled(measured.speed_mm_s(now), 10.0),
        scaled(measured.force_n(now), 10.0),
        scaled(grip.contact_width_mm, 100.0),
        scaled(grip.peak_force_n, 10.0),
        state.latch.as_ref().map_or(0, number_of),
        heartbeat,
        motion_high,
        motion_low,
        scaled(measured.temperature_c(now), 10.0),
    ];
    let holder = name(state.lease_holder.as_deref().unwrap_or_default());
    let mut registers = [0; 32];
    for (register, value) in registers.iter_mut().zip(values.into_iter().chain(holder)) {
        *register = value;
    }
    registers
}

fn status_word(state: &State, view: GripperView<'_>) -> u16 {
    let GripperView { image, holds_lease, is_reserved, now, .. } = view;
    let values = &state.values;
    let ended = match image.command() {
        ImageCommand::Ended(ended) => Some(ended),
        _ => None,
    };
    let is_busy = matches!(image.command(), ImageCommand::Requested | ImageCommand::Admitted(_));
    let is_for_others = !holds_lease && state.reserved_for.is_some() && !is_reserved;
    let is_others = !holds_lease && state.lease_holder.is_some() || is_for_others;
    let is_ready = !state.fault && state.command_id.is_none() && !is_others && image.is_prepared();
    word([
        (READY, is_ready),
        (BUSY, is_busy),
        (DONE, ended.is_some()),
        (OK, ended.is_some_and(|ended| ended.is_ok)),
        (NOK, ended.is_some_and(|ended| !ended.is_ok)),
        (IS_HOLDING, values.is_holding(now)),
        (MOVING, values.has(SystemState::MOVING, now) == Some(true)),
        (REFERENCED, values.has(SystemState::REFERENCED, now) == Some(true)),
        (FAULT, state.fault),
        (FAST_STOP, state.latch.is_some()),
        (LEASE_MINE, holds_lease),
        (LEASE_OTHERS, is_others),
        (CONNECTED, state.link == Link::Connected),
        (PREPARED, image.is_prepared()),
        (STALE, is_stale(state, now)),
        (RESERVED, is_for_others),
    ])
}

/// Whether a value is unknown that the device should report.
fn is_stale(state: &State, now: Instant) -> bool {
    let values = &state.values;
    values.flags(now).is_none() || values.state(now).is_none() || values.stale(now).next().is_some()
}

/// Returns the input registers of the gateway itself.
pub(super) fn of_gateway<'a>(states: impl Iterator<Item = &'a State> + Clone, heartbeat: u16, now: Now) -> Inputs {
    let at = now.instant;
    let bits = word([
        (IS_HOLDING, states.clone().any(|state| state.values.is_holding(at))),
        (MOVING, states.clone().any(|state| state.values.has(SystemState::MOVING, at) == Some(true))),
        (REFERENCED, states.clone().all(|state| state.values.has(SystemState::REFERENCED, at) == Some(true))),
        (FAULT, states.clone().any(|state| state.fault)),
        (FAST_STOP, states.clone().any(|state| state.latch.is_some())),
        (CONNECTED, states.clone().all(|state| state.link == Link::Connected)),
        (STALE, states.clone().any(|state| is_stale(state, at))),
    ]);
    let mut inputs = Inputs::ZERO;
    // There are no more grippers than unit identifiers.
    let count = states.count() as u16;
    for (index, value) in [(0, count), (1, bits), (12, heartbeat)] {
        inputs.gateway[index] = value;
    }
    let clock = now.exact.as_microsecond().to_be_bytes();
    for (index, bytes) in clock.chunks_exact(2).enumerate() {
        inputs.gateway[CLOCK_AT + index] = u16::from_be_bytes([bytes[0], bytes[1]]);
    }
    inputs
}

fn word<const N: usize>(bits: [(u16, bool); N]) -> u16 {
    bits.into_iter().fold(0, |word, (bit, is_set)| word | u16::from(is_set) << bit)
}

fn words(value: u32) -> [u16; 2] {
    // Each half fits.
    [(value >> 16) as u16, value as u16]
}

/// Returns a name, two bytes in a register, without a character that would be cut.
fn name(name: &str) -> [u16; NAME_REGISTERS] {
    let end = name.floor_char_boundary(NAME_REGISTERS * 2);
    let mut registers = [0; NAME_REGISTERS];
    for (register, bytes) in registers.iter_mut().zip(name.as_bytes()[..end].chunks(2)) {
        *register = u16::from_be_bytes([bytes[0], bytes.get(1).copied().unwrap_or_default()]);
    }
    registers
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::model::clock;
    use crate::model::{Fault, Missing, Values};
    use crate::wsg::{GripperState, Temperature};

    fn inputs(state: &State, image: &Image, holds_lease: bool) -> Inputs {
        of_gripper(state, GripperView { image, holds_lease, is_reserved: false, heartbeat: 77, now: clock::instant() })
    }

    fn values() -> Values {
        let flags = SystemState::from_bits_retain(0x0001_0081);
        let mut values = Values::fixed(flags, GripperState::Holding, [20.5, 0.0, -40.25]);
        values.temperature.take(clock::instant(), Temperature(315), Duration::from_hours(1));
        values
    }

    fn ready() -> State {
        State {
            link: Link::Connected,
            fault: false,
            fault_code: 0,
            values: values(),
            lease_holder: Some("plc-\u{fc}".into()),
            last_command: 0x0002_0003,
            ..State::unknown("left".parse().unwrap())
        }
    }

    #[test]
    fn state_of_a_gripper_in_registers() {
        let mut image = Image::new(Instant::now());
        image.write(Instant::now(), 100, &[9, 0]).unwrap();
        let Inputs { fieldbus, gateway } = inputs(&ready(), &image, true);
        assert_eq!(fieldbus, [0x0400, 1, 0x81, 2050, (-4025_i16).cast_unsigned(), 0]);
        assert_eq!(gateway[0], 9);
        assert_eq!(
            gateway[1],
            1 << READY | 1 << IS_HOLDING | 1 << REFERENCED | 1 << LEASE_MINE | 1 << CONNECTED | 1 << PREPARED
        );
        assert_eq!(gateway[2..9], [0, 0, 0, 4, 2050, 0, (-403_i16).cast_unsigned()]);
        assert_eq!(gateway[9..16], [0x8000, 0x8000, 0, 77, 2, 3, 315]);
        let name: Vec<u8> = gateway[16..].iter().flat_map(|word| word.to_be_bytes()).collect();
        assert_eq!(std::str::from_utf8(&name).unwrap().trim_end_matches('\0'), "plc-\u{fc}");
    }

    #[test]
    fn refusal_is_shown_with_its_number() {
        let mut image = Image::new(Instant::now());
        image.write(Instant::now(), 101, &[0]).unwrap();
        let (number, _) = image.write(Instant::now(), 100, &[1, 5]).unwrap().command.unwrap();
        let busy = inputs(&ready(), &image, false);
        assert_eq!((busy.gateway[1] >> BUSY & 1, busy.fieldbus[5]), (1, Status::E_CMD_PENDING.code()));
        image.ended(number, Ended::refused(Code::LeaseHeld));
        let refused = inputs(&ready(), &image, false);
        assert_eq!(refused.gateway[1] & (1 << BUSY | 1 << DONE | 1 << OK | 1 << NOK), 1 << DONE | 1 << NOK);
        assert_eq!(refused.gateway[1] & (1 << READY | 1 << LEASE_OTHERS), 1 << LEASE_OTHERS);
        assert_eq!((refused.gateway[3], refused.fieldbus[5]), (12, Status::E_ACCESS_DENIED.code()));
    }

    #[test]
    fn unknown_values_are_marked() {
        let state = State::unknown("left".parse().unwrap());
        let Inputs { fieldbus, gateway } = inputs(&state, &Image::new(Instant::now()), false);
        assert_eq!(fieldbus, [0, 0, 0, 0x8000, 0x8000, 0]);
        assert_eq!(gateway[1], 1 << FAULT | 1 << STALE);
        assert_eq!(gateway[4], Fault::LinkDown.code());
        assert_eq!(gateway[6..11], [0x8000; 5]);
    }

    #[test]
    fn value_that_is_no_longer_known_sets_a_bit() {
        let mut state = ready();
        state.values.width.lose(Missing::Silent);
        let Inputs { fieldbus, gateway } = inputs(&state, &Image::new(Instant::now()), false);
        assert_eq!((gateway[1] >> STALE & 1, gateway[6], fieldbus[3]), (1, 0x8000, 0x8000));
        assert_eq!(gateway[8], (-403_i16).cast_unsigned(), "the force is known");
        state.values.flags.lose(Missing::Silent);
        let Inputs { fieldbus, gateway } = inputs(&state, &Image::new(Instant::now()), false);
        assert_eq!(gateway[1] & (1 << REFERENCED | 1 << MOVING), 0);
        assert_eq!(fieldbus[1..3], [0, 0]);
    }

    #[test]
    fn gateway_unit_tells_the_time() {
        let now = Now::read();
        let Inputs { gateway, .. } = of_gateway([].into_iter(), 5, now);
        let words = gateway[CLOCK_AT..CLOCK_AT + 4].iter();
        let microseconds = words.fold(0, |sum, word| sum << 16 | i64::from(*word));
        assert_eq!(microseconds, now.exact.as_microsecond());
    }

    #[test]
    fn gateway_sums_up_its_grippers() {
        let (one, other) = (ready(), State::unknown("right".parse().unwrap()));
        let now = Now::read();
        let both = of_gateway([&one, &other].into_iter(), 5, now);
        assert_eq!(both.gateway[..2], [2, 1 << IS_HOLDING | 1 << FAULT | 1 << STALE]);
        assert_eq!((both.gateway[12], both.fieldbus), (5, [0; 6]));
        let one = of_gateway([&one].into_iter(), 5, now);
        assert_eq!(one.gateway[1], 1 << IS_HOLDING | 1 << REFERENCED | 1 << CONNECTED);
    }

    #[test]
    fn long_name_is_cut_between_characters() {
        let long = "x".repeat(31) + "\u{fc}";
        let bytes: Vec<u8> = name(&long).iter().flat_map(|word| word.to_be_bytes()).collect();
        assert_eq!(bytes, ["x".repeat(31).as_bytes(), &[0]].concat());
    }
}
