//! Newest values of the getters with automatic updates, as a device would report them.

use crate::gripper::model::State;
use crate::wsg::{Data, Force, GripperState, Speed, SystemState, Width, id};

/// Returns the newest value of a getter.
pub(super) fn value(id: u8, state: &State) -> Data {
    match id {
        id::GET_SYSTEM_STATE => {
            let flags = SystemState::from_bits_retain(state.flags_raw.unwrap_or_default());
            // The latch holds for clients even if the device has forgotten the FAST STOP or has not received it yet.
            let latched = if state.latch.is_some() { SystemState::FAST_STOP } else { SystemState::empty() };
            Data::SystemState(flags | latched)
        }
        id::GET_GRIPPER_STATE => Data::GripperState(GripperState::from_code(state.state_code.unwrap_or_default())),
        // 0 unless referenced (`fw4-en 3.4.4`).
        id::GET_WIDTH => Data::Width(finite(state.width_mm, Width::new, Width::ZERO)),
        id::GET_SPEED => Data::Speed(finite(state.speed_mm_s, Speed::new, Speed::ZERO)),
        id::GET_FORCE => Data::Force(finite(state.force_n, Force::new, Force::ZERO)),
        _ => Data::None,
    }
}

/// Whether a value shows the latched FAST STOP to its reader. Firmware 4 reports ERROR from then until the next motion.
pub(super) fn tells_fast_stop(data: &Data) -> bool {
    match data {
        Data::SystemState(flags) => flags.contains(SystemState::FAST_STOP),
        Data::GripperState(state) => *state == GripperState::Error,
        _ => false,
    }
}

fn finite<T, E>(value: Option<f32>, new: impl FnOnce(f32) -> Result<T, E>, zero: T) -> T {
    value.and_then(|value| new(value).ok()).unwrap_or(zero)
}
