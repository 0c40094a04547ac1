//! Values of the getters with automatic updates, as a device would report them.

use std::time::Instant;

use crate::gripper::model::State;
use crate::wsg::{Data, GripperState, SystemState, Width, id};

/// Returns the value of a getter, unless it is unknown.
pub(super) fn value(id: u8, state: &State, now: Instant) -> Option<Data> {
    let values = &state.values;
    match id {
        id::GET_SYSTEM_STATE => {
            // The latch holds for clients even if the device has forgotten the FAST STOP or has not received it yet.
            let latched = if state.latch.is_some() { SystemState::FAST_STOP } else { SystemState::empty() };
            values.flags(now).map(|flags| Data::SystemState(flags | latched))
        }
        id::GET_GRIPPER_STATE => values.state(now).map(Data::GripperState),
        // 0 unless referenced (`fw4-en 3.4.4`).
        id::GET_WIDTH if values.has(SystemState::REFERENCED, now) == Some(false) => Some(Data::Width(Width::ZERO)),
        id::GET_WIDTH => values.width.at(now).map(Data::Width),
        id::GET_SPEED => values.speed.at(now).map(Data::Speed),
        id::GET_FORCE => values.force.at(now).map(Data::Force),
        _ => None,
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
