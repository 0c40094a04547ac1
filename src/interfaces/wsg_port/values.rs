//! Values of the getters with automatic updates, as a device would report them.

use std::time::Instant;

use crate::model::State;
use crate::wsg::{Data, GripperState, SystemState, Width, id};

/// Returns the value of a getter for a client, unless it is unknown. `has_failed` is true if the client's last request
/// ended with an error.
pub(super) fn value(id: u8, state: &State, now: Instant, has_failed: bool) -> Option<Data> {
    let values = &state.values;
    match id {
        id::GET_SYSTEM_STATE => {
            let mut flags = values.flags(now)?;
            // The latch holds for clients even if the device has forgotten the FAST STOP or has not received it yet.
            if state.latch.is_some() {
                flags.insert(SystemState::FAST_STOP);
            }
            // The device's own flag is about the gateway's last request, whoever caused it.
            flags.set(SystemState::CMD_FAILURE, has_failed);
            Some(Data::SystemState(flags))
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
