//! The status of a gripper in the fewest bytes, for programs that poll it in each cycle.

use std::time::Instant;

use serde::Serialize;
use utoipa::ToSchema;

use super::{Outcome, State};

/// Status of a gripper for a cyclic program. The whole response, with its header, is smaller than 256 bytes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[allow(clippy::struct_excessive_bools, reason = "each is a bit that a PLC reads")]
#[schema(example = json!({
    "busy": false, "done": true, "ok": true, "nok": false, "holding": true, "fault": false, "fault_code": 0,
    "last_command": 17, "last_outcome_code": 2, "lease_epoch": 7
}))]
pub struct GripperStatus {
    /// Whether a command is running.
    pub busy: bool,
    /// Whether the newest motion has ended.
    pub done: bool,
    /// Whether the newest motion ended as `SUCCESS` or `PART_HELD`.
    pub ok: bool,
    /// Whether the newest motion ended with another outcome.
    pub nok: bool,
    /// Whether the device reports a held part (`HOLDING`). False also while the gripper's state is unknown, which
    /// `fault_code` shows.
    pub holding: bool,
    /// Whether a person or a program has to do something before the next motion.
    pub fault: bool,
    /// Number of the fault, as in the state; 0 without a fault.
    pub fault_code: u16,
    /// Number of the newest motion, as in `number` of the command; 0 before the first.
    #[schema(format = Int64, minimum = 0, maximum = 4_294_967_295_i64)]
    pub last_command: u32,
    /// `outcome_code` of the newest motion; 0 while it runs, and before the first.
    #[schema(minimum = 0, maximum = 255)]
    pub last_outcome_code: u8,
    /// Number of the newest lease.
    pub lease_epoch: u64,
}

impl GripperStatus {
    #[must_use]
    pub fn of(state: &State, now: Instant) -> Self {
        let busy = state.command.is_some();
        let outcome = state.last_outcome.filter(|_| !busy);
        Self {
            busy,
            done: outcome.is_some(),
            ok: outcome.is_some_and(Outcome::is_ok),
            nok: outcome.is_some_and(|outcome| !outcome.is_ok()),
            holding: state.values.is_holding(now),
            fault: state.fault,
            fault_code: state.fault_code,
            last_command: state.last_command,
            last_outcome_code: state.last_outcome.map_or(0, Outcome::code),
            lease_epoch: state.lease_epoch,
        }
    }
}
