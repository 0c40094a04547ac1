//! Command flags of the fieldbus map: the gripper's own cyclic image, as far as it is public.

use serde_json::{Value, json};

use super::order::ModbusOrder;
use crate::operations::gripper::motion;

/// Holding registers of the fieldbus map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FieldbusRegisters {
    pub flags: FieldbusFlags,
    /// In 1/100 mm.
    width: i16,
    /// In 1/100 mm/s.
    speed: u16,
    /// In 1/100 N; 0 keeps the force limit.
    force: u16,
}

/// Command flags. A rising edge executes a flag.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FieldbusFlags(u8);

const MOVE: u8 = 1;
const GRASP: u8 = 1 << 1;
const RELEASE: u8 = 1 << 2;
const HOMING: u8 = 1 << 3;
const STOP_OR_ACKNOWLEDGE: u8 = 1 << 4;
const FAST_STOP: u8 = 1 << 5;
const JOG_OPEN: u8 = 1 << 6;
const JOG_CLOSE: u8 = 1 << 7;

impl From<[u16; 4]> for FieldbusRegisters {
    fn from([word, width, speed, force]: [u16; 4]) -> Self {
        let [flags, _user_flags] = word.to_be_bytes();
        Self { flags: FieldbusFlags(flags), width: width.cast_signed(), speed, force }
    }
}

impl FieldbusFlags {
    pub(super) fn is_empty(self) -> bool {
        self.0 == 0
    }

    pub(super) fn has_fast_stop(self) -> bool {
        self.0 & FAST_STOP != 0
    }

    /// Whether a JOG flag has fallen since `before`.
    pub(super) fn ends_jog_since(self, before: Self) -> bool {
        before.0 & !self.0 & (JOG_OPEN | JOG_CLOSE) != 0
    }

    /// Whether FAST STOP has risen since `before`.
    pub(super) fn fast_stop_since(self, before: Self) -> bool {
        self.0 & !before.0 & FAST_STOP != 0
    }
}

impl FieldbusRegisters {
    /// Returns the order of the flags that have changed since `before`. The lowest rising flag wins, unless a jog ends: a
    /// motion would be refused while the fingers still move. `is_jogging` tells whether a JOG of this client may be moving
    /// the fingers.
    pub(super) fn order_since(self, before: FieldbusFlags, is_jogging: bool) -> Option<ModbusOrder> {
        let rising = self.flags.0 & !before.0;
        let width_mm = f64::from(self.width) / 100.0;
        let speed_mm_s = f64::from(self.speed) / 100.0;
        let lowest = rising & rising.wrapping_neg();
        let ends_jog = is_jogging && self.flags.ends_jog_since(before);
        Some(match lowest {
            _ if ends_jog && rising & STOP_OR_ACKNOWLEDGE == 0 => ModbusOrder::Stop,
            _ if ends_jog => ModbusOrder::StopOrAcknowledge,
            MOVE => ModbusOrder::motion(&motion::MOVE, json!({"width_mm": width_mm, "speed_mm_s": speed_mm_s})),
            GRASP => ModbusOrder::motion(&motion::GRIP, self.grip(width_mm, speed_mm_s)),
            RELEASE => ModbusOrder::motion(&motion::RELEASE, json!({"width_mm": width_mm, "speed_mm_s": speed_mm_s})),
            HOMING => ModbusOrder::motion(&motion::HOME, json!({})),
            STOP_OR_ACKNOWLEDGE => ModbusOrder::StopOrAcknowledge,
            JOG_OPEN | JOG_CLOSE => ModbusOrder::Jog { opens: lowest == JOG_OPEN, speed_mm_s },
            // A FAST STOP takes another path.
            _ => return None,
        })
    }

    fn grip(self, width_mm: f64, speed_mm_s: f64) -> Value {
        match self.force {
            0 => json!({"width_mm": width_mm, "speed_mm_s": speed_mm_s}),
            force => {
                json!({"width_mm": width_mm, "speed_mm_s": speed_mm_s, "force_n": f64::from(force) / 100.0})
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outputs(flags: u8) -> FieldbusRegisters {
        FieldbusRegisters::from([u16::from_be_bytes([flags, 0xA5]), 2050, 5000, 4000])
    }

    fn order(before: u8, flags: u8) -> Option<ModbusOrder> {
        outputs(flags).order_since(FieldbusFlags(before), true)
    }

    #[test]
    fn rising_edges_are_orders() {
        let position = json!({"width_mm": 20.5, "speed_mm_s": 50.0});
        assert_eq!(order(0, MOVE), Some(ModbusOrder::motion(&motion::MOVE, position.clone())));
        let grip = json!({"width_mm": 20.5, "speed_mm_s": 50.0, "force_n": 40.0});
        assert_eq!(order(0, GRASP), Some(ModbusOrder::motion(&motion::GRIP, grip)));
        assert_eq!(order(MOVE, RELEASE), Some(ModbusOrder::motion(&motion::RELEASE, position)));
        assert_eq!(order(0, HOMING), Some(ModbusOrder::motion(&motion::HOME, json!({}))));
        assert_eq!(order(0, STOP_OR_ACKNOWLEDGE), Some(ModbusOrder::StopOrAcknowledge));
        for flag in (0..8).map(|bit| 1 << bit) {
            assert_eq!(order(flag, flag), None, "no edge");
        }
    }

    #[test]
    fn lowest_rising_flag_wins() {
        assert_eq!(order(MOVE, MOVE | RELEASE | HOMING), order(0, RELEASE));
        assert_eq!(order(0, STOP_OR_ACKNOWLEDGE | JOG_OPEN), Some(ModbusOrder::StopOrAcknowledge));
    }

    #[test]
    fn jog_lasts_as_long_as_its_flag() {
        assert_eq!(order(0, JOG_OPEN), Some(ModbusOrder::Jog { opens: true, speed_mm_s: 50.0 }));
        assert_eq!(order(0, JOG_CLOSE), Some(ModbusOrder::Jog { opens: false, speed_mm_s: 50.0 }));
        assert_eq!(order(JOG_OPEN, 0), Some(ModbusOrder::Stop));
        for next in [JOG_CLOSE, MOVE, HOMING] {
            assert_eq!(order(JOG_OPEN, next), Some(ModbusOrder::Stop), "{next}");
        }
        assert_eq!(order(JOG_CLOSE, STOP_OR_ACKNOWLEDGE), Some(ModbusOrder::StopOrAcknowledge));
        assert_eq!(order(MOVE, 0), None);
        assert_eq!(outputs(0).order_since(FieldbusFlags(JOG_OPEN), false), None, "the jog was refused");
        assert_eq!(outputs(MOVE).order_since(FieldbusFlags(JOG_OPEN), false), order(0, MOVE));
    }

    #[test]
    fn fast_stop_is_an_edge_of_its_own() {
        assert!(outputs(FAST_STOP | MOVE).flags.fast_stop_since(FieldbusFlags(0)));
        assert!(!outputs(FAST_STOP).flags.fast_stop_since(FieldbusFlags(FAST_STOP)));
        assert_eq!(order(0, FAST_STOP), None);
    }
}
