//! Conditions that need an action before a gripper can move again.

use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

/// Cause of a FAST STOP.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Hash,
    Serialize,
    Deserialize,
    ToSchema,
    strum::IntoStaticStr,
    VariantArray,
    EnumMessage,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum FastStopCause {
    /// A client requested it.
    Requested,
    /// The lease holder was lost.
    ClientLost,
    /// The gateway's own connection to the device ended without an announcement.
    UnannouncedDisconnect,
    /// The temperature is critical (`TEMP_FAULT`).
    TemperatureFault,
    /// The supply voltage is out of range (`POWER_FAULT`).
    PowerFault,
    /// The motor reached its thermal limit (`CURR_FAULT`).
    CurrentFault,
    /// A finger reported a fault (`FINGER_FAULT`).
    FingerFault,
    /// The fingers moved into a range that the soft limits forbid.
    SoftLimit,
    /// The device is in FAST STOP, and its flags do not show why.
    Unknown,
}

/// Condition that needs an action of a person or a program. Without one, the gripper accepts motions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The link to the device is not connected.
    LinkDown,
    /// The journal is unavailable, and motions are refused meanwhile.
    JournalDown,
    /// The device lost settings of clients that could not be restored.
    SettingsLost,
    /// A value of the device is unknown although the device should report it.
    ValueUnknown,
    /// A FAST STOP is latched.
    FastStop(FastStopCause),
    /// `TEMP_FAULT` without a latched FAST STOP.
    Temperature,
    /// `POWER_FAULT` without a latched FAST STOP.
    Power,
    /// `CURR_FAULT` without a latched FAST STOP.
    Current,
    /// `FINGER_FAULT` without a latched FAST STOP.
    Finger,
    /// The device is in the state ERROR, and nobody has acknowledged a FAST STOP since it entered this state.
    DeviceError,
}

impl Fault {
    /// Number of the fault, `fault_code` in the state. Numbers never change, and 0 stands for no fault.
    #[must_use]
    pub const fn code(self) -> u16 {
        match self {
            Self::LinkDown => 1,
            Self::JournalDown => 2,
            Self::SettingsLost => 3,
            Self::ValueUnknown => 4,
            Self::FastStop(FastStopCause::Requested) => 10,
            Self::FastStop(FastStopCause::ClientLost) => 11,
            Self::FastStop(FastStopCause::UnannouncedDisconnect) => 12,
            Self::FastStop(FastStopCause::TemperatureFault) => 13,
            Self::FastStop(FastStopCause::PowerFault) => 14,
            Self::FastStop(FastStopCause::CurrentFault) => 15,
            Self::FastStop(FastStopCause::FingerFault) => 16,
            Self::FastStop(FastStopCause::SoftLimit) => 17,
            Self::FastStop(FastStopCause::Unknown) => 18,
            Self::Temperature => 20,
            Self::Power => 21,
            Self::Current => 22,
            Self::Finger => 23,
            Self::DeviceError => 30,
        }
    }
}

#[cfg(test)]
mod tests {
    use strum::VariantArray as _;

    use super::*;
    use crate::Outcome;

    const PLC: &str = include_str!("../../deploy/guide/plc.md");

    #[test]
    fn fault_codes_are_never_changed() {
        let causes = FastStopCause::VARIANTS.iter().map(|cause| Fault::FastStop(*cause).code());
        assert_eq!(causes.collect::<Vec<_>>(), (10..19).collect::<Vec<_>>());
        let others = [
            (Fault::LinkDown, 1),
            (Fault::JournalDown, 2),
            (Fault::SettingsLost, 3),
            (Fault::ValueUnknown, 4),
            (Fault::Temperature, 20),
            (Fault::Power, 21),
            (Fault::Current, 22),
            (Fault::Finger, 23),
            (Fault::DeviceError, 30),
        ];
        for (fault, code) in others {
            assert_eq!(fault.code(), code, "{fault:?}");
            assert!(PLC.contains(&format!("\n| {code} | ")), "plc.md lacks {fault:?}");
        }
        for cause in FastStopCause::VARIANTS {
            let row = format!("\n| {} | `{}` |", Fault::FastStop(*cause).code(), cause.name());
            assert!(PLC.contains(&row), "plc.md lacks {row}");
        }
    }

    #[test]
    fn outcome_codes_are_never_changed() {
        let codes: Vec<_> = Outcome::VARIANTS.iter().map(|outcome| (outcome.code(), outcome.name())).collect();
        let pinned = [
            (1, "SUCCESS"),
            (2, "PART_HELD"),
            (3, "NO_PART"),
            (4, "BLOCKED"),
            (5, "ABORTED"),
            (6, "RANGE"),
            (7, "TIMEOUT"),
            (8, "FAILED"),
            (9, "REFUSED"),
            (10, "UNKNOWN"),
            (11, "WRONG_PART"),
        ];
        assert_eq!(codes, pinned);
        for (code, name) in pinned {
            assert!(PLC.contains(&format!("\n| {code} | `{name}` |")), "plc.md lacks {name}");
        }
    }
}
