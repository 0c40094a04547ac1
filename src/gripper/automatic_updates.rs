//! Requests for automatic updates, at a period that the line can carry.

use model::{UpdateMode, UpdateRules};
use wsg::{Command, Updates, id};

/// Getters with automatic updates.
pub(super) const UPDATED: [u8; 5] =
    [id::GET_SYSTEM_STATE, id::GET_GRIPPER_STATE, id::GET_WIDTH, id::GET_SPEED, id::GET_FORCE];

/// Bytes of one frame of each getter in [`UPDATED`].
const UPDATE_BYTES: u32 = 14 + 11 + 14 + 14 + 14;

/// Requests that switch on all automatic updates, at a period that the line can carry.
pub(super) fn switch_on_all(rules: UpdateRules, bytes_per_second: Option<u32>) -> impl Iterator<Item = Command> {
    UPDATED.into_iter().filter_map(move |id| switch_on(id, rules, bytes_per_second))
}

/// Requests that switch off all automatic updates. The flags are last, so that a motion is still noticed meanwhile.
pub(super) fn switch_off_all() -> impl Iterator<Item = Command> {
    UPDATED.into_iter().rev().filter_map(|id| Command::query(id, Updates::Off))
}

/// Request that switches on the updates of one getter.
pub(super) fn switch_on(id: u8, rules: UpdateRules, bytes_per_second: Option<u32>) -> Option<Command> {
    Command::query(id, updates(rules, bytes_per_second))
}

/// Request that reads the flags, and leaves their automatic updates on.
pub(super) fn read_flags(rules: UpdateRules, bytes_per_second: Option<u32>) -> Command {
    Command::GetSystemState(updates(rules, bytes_per_second))
}

fn updates(rules: UpdateRules, bytes_per_second: Option<u32>) -> Updates {
    // Periodic updates are the default, because the next update corrects a value that a damaged frame has lost.
    let on_change = rules.mode == UpdateMode::Changes;
    Updates::On { on_change, period_ms: period_ms(rules, bytes_per_second) }
}

/// Period of the updates: the shortest allowed, or longer if the updates of all devices would otherwise take more than
/// half of the line's capacity.
pub(super) fn period_ms(rules: UpdateRules, bytes_per_second: Option<u32>) -> u16 {
    let UpdateRules { min_period_ms, devices_on_line, .. } = rules;
    let Some(bytes_per_second) = bytes_per_second else { return min_period_ms };
    let half_the_line = (2 * 1000 * UPDATE_BYTES).saturating_mul(devices_on_line).div_ceil(bytes_per_second.max(1));
    u16::try_from(half_the_line).unwrap_or(u16::MAX).max(min_period_ms)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn updates_take_at_most_half_of_the_line() {
        let rules = UpdateRules::default();
        assert_eq!(period_ms(rules, None), 10);
        assert_eq!(period_ms(rules, Some(11_520)), 12, "115200 baud");
        assert_eq!(period_ms(rules, Some(960)), 140, "9600 baud");
        assert_eq!(period_ms(rules, Some(100_000)), 10);
    }

    #[test]
    fn devices_on_one_line_share_half_of_it() {
        let can = "can://can0".parse::<transport::Address>().unwrap().properties().bytes_per_second;
        for (devices_on_line, expected_ms) in [(1, 10), (2, 12), (4, 23), (16, 91)] {
            let rules = UpdateRules { devices_on_line, ..UpdateRules::default() };
            let period_ms = period_ms(rules, can);
            assert_eq!(period_ms, expected_ms, "{devices_on_line}");
            // 21 bits a byte, at 500 kbit/s.
            let load = f64::from(devices_on_line * UPDATE_BYTES * 21) * 1000.0 / f64::from(period_ms);
            assert!(load <= 250_000.0, "{devices_on_line} devices take {load} bit/s");
        }
    }

    #[test]
    fn configured_period_is_the_shortest() {
        let rules = UpdateRules { min_period_ms: 50, ..UpdateRules::default() };
        assert_eq!([None, Some(11_520), Some(960)].map(|line| period_ms(rules, line)), [50, 50, 140]);
    }
}
