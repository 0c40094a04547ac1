//! The newest values of the device, which serve all readers.

use std::time::{Duration, Instant};

use super::model::CommandId;
use crate::wsg::{Command, Data, GripperState, SystemState, Temperature, Updates, id};

/// Getters with automatic updates.
const UPDATED: [u8; 5] = [id::GET_SYSTEM_STATE, id::GET_GRIPPER_STATE, id::GET_WIDTH, id::GET_SPEED, id::GET_FORCE];

/// Bytes of one frame of each getter in [`UPDATED`].
const UPDATE_BYTES: u32 = 14 + 11 + 14 + 14 + 14;

/// Shortest period that a device accepts (`fw4-en 3.4.1`).
const MIN_PERIOD_MS: u16 = 10;

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
    renew_after: Duration,
    /// Whether the flags came more often than they were requested, that is, by automatic updates.
    flows: bool,
}

impl Observed {
    /// No known values, on a line of this speed.
    pub(super) fn new(bytes_per_second: Option<u32>) -> Self {
        let period = Duration::from_millis(period_ms(bytes_per_second).into());
        Self { renew_after: RENEW_AFTER.max(MISSED_PERIODS * period), ..Self::default() }
    }

    /// Whether the flags arriving now were overdue. A device that restarts forgets its automatic updates.
    pub(super) fn were_missed(&mut self, now: Instant) -> bool {
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
pub(super) fn switch_on_all(bytes_per_second: Option<u32>) -> impl Iterator<Item = Command> {
    let period_ms = period_ms(bytes_per_second);
    UPDATED.into_iter().filter_map(move |id| switch_on(id, period_ms))
}

/// Request that switches on the updates of one getter.
pub(super) fn switch_on(id: u8, period_ms: u16) -> Option<Command> {
    // Not on change only: after a damaged frame, the next update corrects the value.
    let updates = Updates::On { on_change: false, period_ms };
    Some(match id {
        id::GET_SYSTEM_STATE => Command::GetSystemState(updates),
        id::GET_GRIPPER_STATE => Command::GetGripperState(updates),
        id::GET_WIDTH => Command::GetWidth(updates),
        id::GET_SPEED => Command::GetSpeed(updates),
        id::GET_FORCE => Command::GetForce(updates),
        _ => return None,
    })
}

/// Period of the updates: 10 ms if the line is fast enough, else long enough that updates take at most half of it.
pub(super) fn period_ms(bytes_per_second: Option<u32>) -> u16 {
    let Some(bytes_per_second) = bytes_per_second else { return MIN_PERIOD_MS };
    let half_the_line = (2 * 1000 * UPDATE_BYTES).div_ceil(bytes_per_second.max(1));
    u16::try_from(half_the_line).unwrap_or(u16::MAX).max(MIN_PERIOD_MS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn updates_take_at_most_half_of_the_line() {
        assert_eq!(period_ms(None), 10);
        assert_eq!(period_ms(Some(11_520)), 12, "115200 baud");
        assert_eq!(period_ms(Some(960)), 140, "9600 baud");
        assert_eq!(period_ms(Some(100_000)), 10);
    }

    #[test]
    fn only_automatic_updates_are_missed() {
        let mut observed = Observed::new(None);
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
        assert_eq!(Observed::new(Some(11_520)).renew_after, Duration::from_secs(1));
        assert_eq!(Observed::new(Some(120)).renew_after, Duration::from_millis(3351), "1200 baud");
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
            let mut observed = Observed::new(None);
            for data in &seen {
                observed.take(Instant::now(), data);
            }
            assert_eq!(observed.part.is_held, held, "{seen:?}");
        }
    }

    #[test]
    fn width_updates_are_not_missed_before_referencing() {
        let mut observed = Observed::new(None);
        let start = Instant::now();
        observed.asked(start, id::GET_WIDTH);
        let later = start + RENEW_AFTER;
        assert_eq!(observed.silent(later), None);
        observed.take(later, &Data::SystemState(SystemState::REFERENCED));
        assert_eq!(observed.silent(later), Some(id::GET_WIDTH));
    }
}
