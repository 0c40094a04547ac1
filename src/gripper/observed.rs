//! The newest values of the device, which serve all readers.

use std::time::{Duration, Instant};

use super::model::{CommandId, UpdateMode, UpdateRules};
use crate::wsg::{Command, Data, GripperState, SystemState, Temperature, Updates, id};

/// Getters with automatic updates.
const UPDATED: [u8; 5] = [id::GET_SYSTEM_STATE, id::GET_GRIPPER_STATE, id::GET_WIDTH, id::GET_SPEED, id::GET_FORCE];

/// Bytes of one frame of each getter in [`UPDATED`].
const UPDATE_BYTES: u32 = 14 + 11 + 14 + 14 + 14;

/// Silence of a getter after which its updates are switched on again; on a slow line, a few periods if that is longer.
/// A device that refuses updates answers each time with the value, so it is polled at this period.
const RENEW_AFTER: Duration = Duration::from_secs(1);

/// Periods without an update after which updates count as stopped.
const MISSED_PERIODS: u32 = 3;

/// A part between the fingers, as far as known.
#[derive(Debug, Default)]
pub(super) struct HeldPart {
    /// Whether a part is held. Stays true until the device's state shows that the part is gone.
    pub is_held: bool,
    /// Id of the grip that holds the part; `None` for a part that another program gripped.
    pub grip: Option<CommandId>,
}

#[derive(Debug, Default)]
pub(super) struct Observed {
    pub flags: Option<SystemState>,
    pub gripper_state: Option<GripperState>,
    /// Whether the ERROR that the device reports remains from an acknowledged FAST STOP (`fw4-en 3.4.2`).
    error_is_acknowledged: bool,
    pub width_mm: Option<f32>,
    pub speed_mm_s: Option<f32>,
    pub force_n: Option<f32>,
    pub temperature: Option<Temperature>,
    /// Time at which the temperature is read next.
    pub temperature_at: Option<Instant>,
    pub updated_at: Option<Instant>,
    pub part: HeldPart,
    /// Time at which each getter of [`UPDATED`] was last heard.
    heard: [Option<Instant>; UPDATED.len()],
    /// Time at which each getter was last heard or requested.
    fresh: [Option<Instant>; UPDATED.len()],
    /// Period of the automatic updates.
    pub period: Duration,
    renew_after: Duration,
    /// Whether values arrive only when they have changed.
    is_on_change: bool,
    /// Whether the flags came more often than they were requested, that is, by automatic updates.
    flows: bool,
}

impl Observed {
    /// No known values, on a line of this speed.
    pub(super) fn new(rules: UpdateRules, bytes_per_second: Option<u32>) -> Self {
        let mut new = Self::default();
        new.set_rules(rules, bytes_per_second);
        new
    }

    pub(super) fn set_rules(&mut self, rules: UpdateRules, bytes_per_second: Option<u32>) {
        let period = Duration::from_millis(period_ms(rules, bytes_per_second).into());
        self.period = period;
        self.is_on_change = rules.mode == UpdateMode::Changes;
        // A device whose values do not change sends nothing. It is polled after one period, so that its replies arrive
        // before the link counts as unresponsive.
        let periods = if self.is_on_change { 1 } else { MISSED_PERIODS };
        self.renew_after = RENEW_AFTER.max(periods * period);
    }

    /// Whether the flags arriving now were overdue. A device that restarts forgets its automatic updates. Updates on
    /// change are never overdue, so a restart then shows only as a silent link or a lost reference.
    pub(super) fn were_missed(&mut self, now: Instant) -> bool {
        if self.is_on_change {
            return false;
        }
        let [Some(heard), ..] = self.heard else { return false };
        let silence = now.saturating_duration_since(heard);
        let missed = self.flows && silence >= self.renew_after;
        self.flows = silence < self.renew_after / 2;
        missed
    }

    /// Takes a value from the device.
    pub(super) fn take(&mut self, now: Instant, data: &Data) {
        let id = match *data {
            Data::SystemState(flags) => {
                self.flags = Some(flags);
                id::GET_SYSTEM_STATE
            }
            Data::GripperState(state) => {
                self.part.is_held = self.holds_part_in(state);
                self.gripper_state = Some(state);
                self.error_is_acknowledged &= state == GripperState::Error;
                id::GET_GRIPPER_STATE
            }
            Data::Width(width) => {
                self.width_mm = Some(width.mm());
                id::GET_WIDTH
            }
            Data::Speed(speed) => {
                self.speed_mm_s = Some(speed.mm_s());
                id::GET_SPEED
            }
            Data::Force(force) => {
                self.force_n = Some(force.n());
                id::GET_FORCE
            }
            _ => return,
        };
        self.updated_at = Some(now);
        self.asked(now, id);
        if let Some(index) = UPDATED.iter().position(|&updated| updated == id) {
            self.heard[index] = Some(now);
        }
    }

    /// Whether a part is held in this state. A FAST STOP ends HOLDING, but the part may still be between the fingers.
    /// Neither ERROR nor the IDLE after it shows whether it is, nor the IDLE that fw2 reports instead of ERROR.
    fn holds_part_in(&self, state: GripperState) -> bool {
        match state {
            GripperState::Holding => true,
            GripperState::NoPart | GripperState::PartLost => false,
            GripperState::Idle => {
                let tells_nothing = matches!(self.gripper_state, None | Some(GripperState::Idle | GripperState::Error));
                self.part.is_held && (tells_nothing || self.has(SystemState::FAST_STOP))
            }
            _ => self.part.is_held,
        }
    }

    /// Whether every value was heard since `then`.
    pub(super) fn is_newer_than(&self, then: Instant) -> bool {
        self.heard.iter().all(|heard| heard.is_some_and(|heard| heard > then))
    }

    /// Notes an acknowledgement. ERROR persists after it until the next motion (`fw4-en 3.4.2`).
    pub(super) fn acknowledged(&mut self) {
        self.error_is_acknowledged = true;
    }

    /// Whether the device reports an error that nobody has acknowledged.
    pub(super) fn has_error(&self) -> bool {
        self.gripper_state == Some(GripperState::Error) && !self.error_is_acknowledged
    }

    /// Whether a flag is known to be set.
    pub(super) fn has(&self, flag: SystemState) -> bool {
        self.flags.is_some_and(|flags| flags.contains(flag))
    }

    /// Whether the device shows a fault or an error. Firmware 2 has no error state and reserves its number.
    pub(super) fn shows_fault(&self) -> bool {
        let is_error = self.gripper_state.is_some_and(|state| state.code() >= GripperState::Error.code());
        is_error || self.flags.is_some_and(|flags| flags.intersects(SystemState::FAULTS | SystemState::CMD_FAILURE))
    }

    /// The newest value of a getter with automatic updates, in the form of its reply.
    pub(super) fn newest(&self, id: u8) -> Option<Data> {
        use crate::wsg::{Force, Speed, Width};
        match id {
            id::GET_SYSTEM_STATE => self.flags.map(Data::SystemState),
            id::GET_GRIPPER_STATE => self.gripper_state.map(Data::GripperState),
            id::GET_WIDTH => self.width_mm.and_then(|mm| Width::new(mm).ok()).map(Data::Width),
            id::GET_SPEED => self.speed_mm_s.and_then(|mm_s| Speed::new(mm_s).ok()).map(Data::Speed),
            id::GET_FORCE => self.force_n.and_then(|n| Force::new(n).ok()).map(Data::Force),
            _ => None,
        }
    }

    /// A getter whose updates have to be switched on again, if there is one. Opening-width updates are not expected
    /// before the fingers are referenced (`fw4-en 3.4.4`).
    pub(super) fn silent(&self, now: Instant) -> Option<u8> {
        self.deadlines().find(|&(_, deadline)| deadline <= now).map(|(id, _)| id)
    }

    /// Time at which the next getter will have been silent for too long.
    pub(super) fn next_silent(&self) -> Option<Instant> {
        self.deadlines().map(|(_, deadline)| deadline).min()
    }

    fn deadlines(&self) -> impl Iterator<Item = (u8, Instant)> {
        let referenced = self.has(SystemState::REFERENCED);
        let expected = move |&(id, _): &(u8, _)| referenced || id != id::GET_WIDTH;
        let silent_from = |(id, fresh): (u8, &Option<Instant>)| fresh.map(|fresh| (id, fresh + self.renew_after));
        UPDATED.into_iter().zip(&self.fresh).filter_map(silent_from).filter(expected)
    }

    /// Notes that a getter was requested, so that it is not requested again at once.
    pub(super) fn asked(&mut self, now: Instant, id: u8) {
        if let Some(index) = UPDATED.iter().position(|&updated| updated == id) {
            self.fresh[index] = Some(now);
        }
    }
}

/// Requests that switch on all automatic updates, at a period that the line can carry.
pub(super) fn switch_on_all(rules: UpdateRules, bytes_per_second: Option<u32>) -> impl Iterator<Item = Command> {
    UPDATED.into_iter().filter_map(move |id| switch_on(id, rules, bytes_per_second))
}

/// Requests that switch off all automatic updates. The flags are last, so that a motion is still noticed meanwhile.
pub(super) fn switch_off_all() -> impl Iterator<Item = Command> {
    UPDATED.into_iter().rev().filter_map(|id| request(id, Updates::Off))
}

/// Request that switches on the updates of one getter.
pub(super) fn switch_on(id: u8, rules: UpdateRules, bytes_per_second: Option<u32>) -> Option<Command> {
    request(id, updates(rules, bytes_per_second))
}

fn request(id: u8, updates: Updates) -> Option<Command> {
    Some(match id {
        id::GET_SYSTEM_STATE => Command::GetSystemState(updates),
        id::GET_GRIPPER_STATE => Command::GetGripperState(updates),
        id::GET_WIDTH => Command::GetWidth(updates),
        id::GET_SPEED => Command::GetSpeed(updates),
        id::GET_FORCE => Command::GetForce(updates),
        _ => return None,
    })
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
        let period_ms = |line| period_ms(UpdateRules::default(), line);
        assert_eq!(period_ms(None), 10);
        assert_eq!(period_ms(Some(11_520)), 12, "115200 baud");
        assert_eq!(period_ms(Some(960)), 140, "9600 baud");
        assert_eq!(period_ms(Some(100_000)), 10);
    }

    #[test]
    fn devices_on_one_line_share_half_of_it() {
        let can = "can://can0".parse::<crate::transport::Address>().unwrap().properties().bytes_per_second;
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

    #[test]
    fn updates_on_change_are_polled_and_never_missed() {
        let rules = UpdateRules { mode: UpdateMode::Changes, min_period_ms: 500, ..UpdateRules::default() };
        let mut observed = Observed::new(rules, None);
        let on_change = Updates::On { on_change: true, period_ms: 500 };
        assert_eq!(switch_on(id::GET_SYSTEM_STATE, rules, None), Some(Command::GetSystemState(on_change)));
        let mut now = Instant::now();
        for after_ms in [10, 10, 10, 1000, 1000] {
            now += Duration::from_millis(after_ms);
            assert!(!observed.were_missed(now));
            observed.take(now, &Data::SystemState(SystemState::REFERENCED));
        }
        assert_eq!(observed.next_silent(), Some(now + RENEW_AFTER));
    }

    #[test]
    fn only_automatic_updates_are_missed() {
        let mut observed = Observed::new(UpdateRules::default(), None);
        let mut now = Instant::now();
        let mut hear_after = |milliseconds| {
            now += Duration::from_millis(milliseconds);
            let missed = observed.were_missed(now);
            observed.take(now, &Data::SystemState(SystemState::empty()));
            missed
        };
        for _ in 0..5 {
            assert!(!hear_after(1000), "polled");
        }
        assert!(!hear_after(10) && !hear_after(10));
        assert!(hear_after(1000));
        assert!(!hear_after(1000), "polled since");
    }

    #[test]
    fn slow_lines_get_a_few_periods() {
        let renew_after = |line| Observed::new(UpdateRules::default(), Some(line)).renew_after;
        assert_eq!(renew_after(11_520), Duration::from_secs(1));
        assert_eq!(renew_after(120), Duration::from_millis(3351), "1200 baud");
    }

    #[test]
    fn parts_are_held_until_known_to_be_gone() {
        use GripperState::{Error, Holding, Idle, NoPart, PartLost, Releasing};
        let stopped = Data::SystemState(SystemState::FAST_STOP);
        let holds = |state| Data::GripperState(state);
        for (seen, held) in [
            (vec![holds(Holding), holds(Error), holds(Idle), holds(Idle)], true),
            (vec![holds(Holding), stopped.clone(), holds(Idle), Data::SystemState(SystemState::empty())], true),
            (vec![holds(Holding), holds(Error), holds(Releasing), holds(Idle)], false),
            (vec![holds(Holding), holds(Error), holds(PartLost)], false),
            (vec![holds(Holding), holds(NoPart)], false),
            (vec![holds(Holding), holds(Idle)], false),
            (vec![stopped, holds(Error), holds(Idle)], false),
        ] {
            let mut observed = Observed::new(UpdateRules::default(), None);
            for data in &seen {
                observed.take(Instant::now(), data);
            }
            assert_eq!(observed.part.is_held, held, "{seen:?}");
        }
    }

    #[test]
    fn width_updates_are_not_missed_before_referencing() {
        let mut observed = Observed::new(UpdateRules::default(), None);
        let start = Instant::now();
        observed.asked(start, id::GET_WIDTH);
        let later = start + RENEW_AFTER;
        assert_eq!(observed.silent(later), None);
        observed.take(later, &Data::SystemState(SystemState::REFERENCED));
        assert_eq!(observed.silent(later), Some(id::GET_WIDTH));
    }
}
