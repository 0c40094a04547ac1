//! The system state flags (`fw4-en` Appendix B) and the gripper states (`fw4-en 3.4.2`).

bitflags::bitflags! {
    /// The 32 flags of Get System State (40h). They are for information only: follow a gripping process by
    /// [`GripperState`]. Reserved bits (10, 11 and 21 to 31) survive a round trip.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct SystemState: u32 {
        /// The fingers are referenced.
        const REFERENCED = 1;
        /// The fingers are moving.
        const MOVING = 1 << 1;
        /// The axis is blocked in negative direction, until the block is gone or Stop clears the flag (fw4).
        const BLOCKED_MINUS = 1 << 2;
        /// The axis is blocked in positive direction, until the block is gone or Stop clears the flag (fw4).
        const BLOCKED_PLUS = 1 << 3;
        /// The soft limit in negative direction was reached, until the fingers move away from it.
        const SOFT_LIMIT_MINUS = 1 << 4;
        /// The soft limit in positive direction was reached, until the fingers move away from it.
        const SOFT_LIMIT_PLUS = 1 << 5;
        /// Stop aborted a motion; set until the next motion.
        const AXIS_STOPPED = 1 << 6;
        /// The target position was reached. Not synchronous with `MOVING` (fw4).
        const TARGET_POS_REACHED = 1 << 7;
        /// Overdrive Mode is on: the force limit can be set up to the overdrive force.
        const OVERDRIVE_MODE = 1 << 8;
        /// True force control with a force measurement finger is active.
        const FORCECNTL_MODE = 1 << 9;
        /// A FAST STOP is active, until it is acknowledged.
        const FAST_STOP = 1 << 12;
        /// The temperature will soon be critical.
        const TEMP_WARNING = 1 << 13;
        /// The temperature is critical: no motion until it has fallen.
        const TEMP_FAULT = 1 << 14;
        /// The power supply is outside its valid range.
        const POWER_FAULT = 1 << 15;
        /// The motor reached its thermal limit. Clears by itself (fw4); then the FAST STOP can be acknowledged.
        const CURR_FAULT = 1 << 16;
        /// A finger is neither operating nor absent.
        const FINGER_FAULT = 1 << 17;
        /// The last command returned an error.
        const CMD_FAILURE = 1 << 18;
        /// A script is running on the device.
        const SCRIPT_RUNNING = 1 << 19;
        /// An error aborted a script; set until a script is started.
        const SCRIPT_FAILURE = 1 << 20;

        const _ = !0;
    }
}

impl SystemState {
    /// Flags that indicate a device fault.
    pub const FAULTS: Self =
        Self::TEMP_FAULT.union(Self::POWER_FAULT).union(Self::CURR_FAULT).union(Self::FINGER_FAULT);

    /// Names of the flags that are set, in bit order. Reserved bits have no name.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        self.iter_names().map(|(name, _)| name)
    }
}

/// State of the gripping process (`fw4-en 3.4.2`; "grasping state" in fw2).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum GripperState {
    /// 0: waiting for a command.
    #[default]
    Idle,
    /// 1: the fingers are closing on a part.
    Grasping,
    /// 2: no part was found; lasts until the next motion.
    NoPart,
    /// 3: a part was gripped, then lost; lasts until the next motion.
    PartLost,
    /// 4: a part is held with the gripping force.
    Holding,
    /// 5: the fingers are opening.
    Releasing,
    /// 6: pre-positioning, or homing (fw4).
    Positioning,
    /// 7: an error or a FAST STOP (fw4; reserved in fw2).
    Error,
    /// 8 and up: reserved.
    Reserved(u8),
}

impl GripperState {
    /// Decodes the byte of Get Gripper State (41h).
    #[must_use]
    pub const fn from_code(code: u8) -> Self {
        match code {
            0 => Self::Idle,
            1 => Self::Grasping,
            2 => Self::NoPart,
            3 => Self::PartLost,
            4 => Self::Holding,
            5 => Self::Releasing,
            6 => Self::Positioning,
            7 => Self::Error,
            reserved => Self::Reserved(reserved),
        }
    }

    /// The byte of Get Gripper State (41h).
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Idle => 0,
            Self::Grasping => 1,
            Self::NoPart => 2,
            Self::PartLost => 3,
            Self::Holding => 4,
            Self::Releasing => 5,
            Self::Positioning => 6,
            Self::Error => 7,
            Self::Reserved(code) => code,
        }
    }

    /// The manual's name for the state, in capitals.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Idle => "IDLE",
            Self::Grasping => "GRASPING",
            Self::NoPart => "NO_PART",
            Self::PartLost => "PART_LOST",
            Self::Holding => "HOLDING",
            Self::Releasing => "RELEASING",
            Self::Positioning => "POSITIONING",
            Self::Error => "ERROR",
            Self::Reserved(_) => "RESERVED",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reserved_bits_survive_a_round_trip() {
        let state = SystemState::from_bits_retain(0xFFFF_FFFF);
        assert_eq!(state.bits(), 0xFFFF_FFFF);
        let state = SystemState::from_bits_retain(1 << 10 | 1 << 31 | 1);
        assert_eq!(state.bits(), 1 << 10 | 1 << 31 | 1);
        assert_eq!(state.names().collect::<Vec<_>>(), ["REFERENCED"]);
    }

    #[test]
    fn flags_have_the_manuals_bit_numbers() {
        let bits: Vec<_> = SystemState::all().iter_names().map(|(_, flag)| flag.bits().trailing_zeros()).collect();
        assert_eq!(bits, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20]);
    }

    #[test]
    fn gripper_state_bytes_survive_a_round_trip() {
        for code in 0..=u8::MAX {
            assert_eq!(GripperState::from_code(code).code(), code);
        }
        assert_eq!(GripperState::from_code(7).name(), "ERROR");
    }
}
