//! The newest values of the device, which serve all readers.

use std::time::{Duration, Instant};

use super::Now;
use super::automatic_updates::{UPDATED, period_ms};
use super::limits::{FASTEST_MM_S, STRONGEST_N, WIDEST_MM};
use model::{CommandId, LinkClock, Measured, Missing, UpdateMode, UpdateRules, Values};
use wsg::{Data, GripperState, SystemState, id};

/// Periods that a value can miss before it counts as unknown.
const GOOD_PERIODS: u32 = 5;

/// Shortest time for which a value is good: a short disturbance of the line must not make it unknown.
const GOOD_FOR_AT_LEAST: Duration = Duration::from_millis(500);

/// Period at which values are polled that the device sends only when they change, unless its own period is longer. Five
/// of them pass before a value counts as unknown.
const POLLED_EVERY: Duration = Duration::from_millis(300);

/// Period of reading the temperature, which has no automatic updates (`fw4-en 3.4.7`) and changes slowly.
pub(super) const TEMPERATURE_EVERY: Duration = Duration::from_secs(5);

/// Polls of the temperature that can fail before it counts as unknown.
const TEMPERATURE_POLLS: u32 = 3;

/// Period from which a line counts as slow: a client's longest frame can delay an update for longer than a restart.
const SLOW_PERIOD: Duration = Duration::from_millis(100);

/// Silence of the flags after which a device on a slow line may have restarted; a few periods if that is longer. On
/// another line, the device may have restarted as soon as the flags have to be requested.
const MISSED_AFTER: Duration = Duration::from_secs(1);

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
#[allow(clippy::struct_excessive_bools, reason = "facts that are independent")]
pub(super) struct Observed {
    pub values: Values,
    /// Whether the ERROR that the device reports remains from an acknowledged FAST STOP (`fw4-en 3.4.2`).
    error_is_acknowledged: bool,
    /// Time at which the temperature is read next.
    pub temperature_at: Option<Instant>,
    pub part: HeldPart,
    /// Time at which each getter of [`UPDATED`] was last heard or requested.
    fresh: [Option<Instant>; UPDATED.len()],
    /// Period of the automatic updates.
    pub period: Duration,
    /// Time for which a value is good without a further frame.
    pub good_for: Duration,
    /// Silence of a getter after which its updates are switched on again. A device that refuses updates answers each
    /// time with the value, so it is polled at this period.
    renew_after: Duration,
    /// Silence of the flags after which they were missed.
    missed_after: Duration,
    /// Whether values arrive only when they have changed.
    is_on_change: bool,
    /// Whether the flags were requested since they were last heard.
    flags_requested: bool,
    /// Whether the last flags came by themselves, that is, by automatic updates.
    flows: bool,
    /// Whether the last flags, and the last gripper state, were not believed alone.
    doubted: [bool; 2],
    /// Values that were reported as missing.
    reported: Vec<(&'static str, Missing)>,
}

/// Values that became unknown since the last report, with their reason, and values that are known again.
#[derive(Debug, Default)]
pub(super) struct MissingReport {
    pub lost: Vec<(&'static str, Missing)>,
    pub found: Vec<&'static str>,
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
        let renewals_every = if self.is_on_change { POLLED_EVERY.max(period) } else { period };
        self.good_for = GOOD_FOR_AT_LEAST.max(GOOD_PERIODS * renewals_every);
        // Values are requested early enough for a second request before they become unknown.
        self.renew_after = if self.is_on_change { renewals_every } else { self.good_for / 2 };
        let is_slow = period > SLOW_PERIOD;
        self.missed_after = if is_slow { MISSED_AFTER.max(MISSED_PERIODS * period) } else { self.renew_after };
    }

    /// Notes that a link was set up: the device should report its values from now on.
    pub(super) fn link_set_up(&mut self, now: Instant, has_temperature: bool) {
        let until = now + self.good_for;
        self.values.flags.expect(until);
        self.values.state.expect(until);
        self.values.speed.expect(until);
        self.values.force.expect(until);
        if self.has(SystemState::REFERENCED) {
            self.values.width.expect(until);
        }
        self.temperature_at = has_temperature.then_some(now);
        if has_temperature {
            self.values.temperature.expect(now + TEMPERATURE_EVERY * TEMPERATURE_POLLS);
        }
    }

    /// Notes the beginning of a connection.
    pub(super) fn link_up(&mut self, now: Now) {
        self.values.clock = Some(LinkClock { instant: now.instant, wall: now.exact });
    }

    /// Notes that nothing is known without a link.
    pub(super) fn link_down(&mut self) {
        self.values.forget();
        self.reported.clear();
    }

    /// Whether the flags arriving now were overdue. A device that restarts forgets its automatic updates. Updates on
    /// change are never overdue, so a restart then shows only as a silent link or a lost reference.
    pub(super) fn were_missed(&mut self, now: Instant) -> bool {
        if self.is_on_change {
            return false;
        }
        let Some(heard) = self.values.flags.arrived_at() else { return false };
        let is_late = now.saturating_duration_since(heard) >= self.missed_after;
        let missed = self.flows && self.flags_requested && is_late;
        self.flows = !self.flags_requested;
        missed
    }

    /// Notes an alarming value. Returns whether it is the first of its getter, which is not believed alone. Any value that
    /// is taken ends the doubt.
    pub(super) fn doubt(&mut self, data: &Data) -> bool {
        let index = usize::from(matches!(data, Data::GripperState(_)));
        self.doubted.get_mut(index).is_some_and(|doubted| !std::mem::replace(doubted, true))
    }

    /// Takes a value from the device.
    pub(super) fn take(&mut self, now: Instant, data: &Data) {
        let good_for = self.good_for;
        let id = match *data {
            Data::SystemState(flags) => {
                self.doubted[0] = false;
                self.take_flags(now, flags);
                id::GET_SYSTEM_STATE
            }
            Data::GripperState(state) => {
                self.doubted[1] = false;
                self.part.is_held = self.holds_part_in(state);
                self.values.state.take(now, state, good_for);
                self.error_is_acknowledged &= state == GripperState::Error;
                id::GET_GRIPPER_STATE
            }
            Data::Width(width) => {
                if self.has(SystemState::REFERENCED) {
                    take_within(&mut self.values.width, now, (width, width.mm(), WIDEST_MM), good_for);
                }
                id::GET_WIDTH
            }
            Data::Speed(speed) => {
                take_within(&mut self.values.speed, now, (speed, speed.mm_s(), FASTEST_MM_S), good_for);
                id::GET_SPEED
            }
            Data::Force(force) => {
                take_within(&mut self.values.force, now, (force, force.n(), STRONGEST_N), good_for);
                id::GET_FORCE
            }
            Data::Temperature(temperature) => {
                return self.values.temperature.take(now, temperature, TEMPERATURE_EVERY * TEMPERATURE_POLLS);
            }
            _ => return,
        };
        self.heard_or_requested(now, id);
    }

    fn take_flags(&mut self, now: Instant, flags: SystemState) {
        self.values.flags.take(now, flags, self.good_for);
        self.flags_requested = false;
        if !flags.contains(SystemState::REFERENCED) {
            self.values.width.forget();
        } else if !self.values.width.is_expected() {
            self.values.width.expect(now + self.good_for);
        }
    }

    /// Notes that a getter returned something else than its value.
    pub(super) fn lose(&mut self, id: u8, missing: Missing) {
        match id {
            id::GET_SYSTEM_STATE => self.values.flags.lose(missing),
            id::GET_GRIPPER_STATE => self.values.state.lose(missing),
            id::GET_WIDTH => self.values.width.lose(missing),
            id::GET_SPEED => self.values.speed.lose(missing),
            id::GET_FORCE => self.values.force.lose(missing),
            id::GET_TEMPERATURE => self.values.temperature.lose(missing),
            _ => {}
        }
    }

    /// Returns the values that have become missing or known again since the last call.
    pub(super) fn report(&mut self, now: Instant) -> Option<MissingReport> {
        let missing: Vec<_> = self.values.missing(now).collect();
        if missing == self.reported {
            return None;
        }
        let lost: Vec<_> = missing.iter().filter(|missing| !self.reported.contains(missing)).copied().collect();
        let known = self.reported.extract_if(.., |(name, _)| self.values.is_known(name, now));
        let found: Vec<_> = known.map(|(name, _)| name).collect();
        // A value that is not expected for a while, such as the width while homing, is not known again.
        self.reported.retain(|(name, _)| !missing.iter().any(|(missing, _)| missing == name));
        self.reported.extend(missing);
        (!lost.is_empty() || !found.is_empty()).then_some(MissingReport { lost, found })
    }

    /// Whether a part is held in this state. A FAST STOP ends HOLDING, but the part may still be between the fingers.
    /// Neither ERROR nor the IDLE after it shows whether it is, nor the IDLE that fw2 reports instead of ERROR.
    fn holds_part_in(&self, state: GripperState) -> bool {
        match state {
            GripperState::Holding => true,
            GripperState::NoPart | GripperState::PartLost => false,
            GripperState::Idle => {
                let tells_nothing = matches!(self.last_state(), None | Some(GripperState::Idle | GripperState::Error));
                self.part.is_held && (tells_nothing || self.has(SystemState::FAST_STOP))
            }
            _ => self.part.is_held,
        }
    }

    /// Whether every value that is expected arrived since `then`.
    pub(super) fn is_newer_than(&self, then: Instant) -> bool {
        let Values { flags, state, width, speed, force, .. } = &self.values;
        let arrivals = [flags.arrived_at(), state.arrived_at(), speed.arrived_at(), force.arrived_at()];
        let width_arrival = width.is_expected().then_some(width.arrived_at());
        arrivals.into_iter().chain(width_arrival).all(|arrived_at| arrived_at > Some(then))
    }

    /// Whether the device sends its values by itself, again and again.
    pub(super) fn flows(&self) -> bool {
        self.flows && !self.is_on_change
    }

    /// Whether values arrive only when they have changed.
    pub(super) fn is_on_change(&self) -> bool {
        self.is_on_change
    }

    /// The newest flags, however old they are.
    pub(super) fn last_flags(&self) -> Option<SystemState> {
        self.values.flags.last()
    }

    /// The newest gripper state, however old it is.
    pub(super) fn last_state(&self) -> Option<GripperState> {
        self.values.state.last()
    }

    /// Notes an acknowledgement. ERROR persists after it until the next motion (`fw4-en 3.4.2`).
    pub(super) fn acknowledged(&mut self) {
        self.error_is_acknowledged = true;
    }

    /// Whether the device reports an error that nobody has acknowledged.
    pub(super) fn has_error(&self) -> bool {
        self.last_state() == Some(GripperState::Error) && !self.error_is_acknowledged
    }

    /// Whether a flag was set when the flags were last heard.
    pub(super) fn has(&self, flag: SystemState) -> bool {
        self.last_flags().is_some_and(|flags| flags.contains(flag))
    }

    /// Whether the device shows a fault or an error. Firmware 2 has no error state and reserves its number.
    pub(super) fn shows_fault(&self) -> bool {
        let is_error = self.last_state().is_some_and(|state| state.code() >= GripperState::Error.code());
        is_error
            || self.last_flags().is_some_and(|flags| flags.intersects(SystemState::FAULTS | SystemState::CMD_FAILURE))
    }

    /// The value of a getter with automatic updates, in the form of its reply, unless it is unknown.
    pub(super) fn value(&self, id: u8, now: Instant) -> Option<Data> {
        let values = &self.values;
        match id {
            id::GET_SYSTEM_STATE => values.flags.at(now).map(Data::SystemState),
            id::GET_GRIPPER_STATE => values.state.at(now).map(Data::GripperState),
            id::GET_WIDTH => values.width.at(now).map(Data::Width),
            id::GET_SPEED => values.speed.at(now).map(Data::Speed),
            id::GET_FORCE => values.force.at(now).map(Data::Force),
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
        let getters = UPDATED.into_iter().zip(&self.fresh);
        getters
            .filter_map(|(id, fresh)| fresh.map(|fresh| (id, fresh + self.renew_after)))
            .filter(move |&(id, _)| referenced || id != id::GET_WIDTH)
    }

    /// Notes that a getter was requested, so that it is not requested again at once.
    pub(super) fn requested(&mut self, now: Instant, id: u8) {
        self.flags_requested |= id == id::GET_SYSTEM_STATE;
        self.heard_or_requested(now, id);
    }

    fn heard_or_requested(&mut self, now: Instant, id: u8) {
        if let Some(index) = UPDATED.iter().position(|&updated| updated == id) {
            self.fresh[index] = Some(now);
        }
    }
}

/// Takes a number, unless its magnitude is one that no gripper can have.
fn take_within<T: Copy + PartialEq>(
    measured: &mut Measured<T>,
    now: Instant,
    (value, number, greatest): (T, f32, f32),
    good_for: Duration,
) {
    if number.abs() <= greatest {
        measured.take(now, value, good_for);
    } else {
        measured.lose(Missing::Impossible);
    }
}

#[cfg(test)]
mod tests {
    use super::super::automatic_updates::switch_on;
    use super::*;
    use wsg::{Command, Force, Speed, Updates, Width};

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
        assert_eq!(observed.next_silent(), Some(now + Duration::from_millis(500)));
    }

    #[test]
    fn only_automatic_updates_are_missed() {
        let mut observed = Observed::new(UpdateRules::default(), None);
        let mut now = Instant::now();
        for _ in 0..5 {
            now += Duration::from_secs(1);
            observed.requested(now, id::GET_SYSTEM_STATE);
            assert!(!flags_were_missed(&mut observed, now), "polled");
        }
        for after_ms in [10, 10, 250] {
            now += Duration::from_millis(after_ms);
            assert!(!flags_were_missed(&mut observed, now), "late, but not by a restart");
        }
        now += Duration::from_secs(1);
        observed.requested(now, id::GET_SYSTEM_STATE);
        assert!(flags_were_missed(&mut observed, now));
        now += Duration::from_secs(1);
        assert!(!flags_were_missed(&mut observed, now), "polled since");
    }

    fn flags_were_missed(observed: &mut Observed, now: Instant) -> bool {
        let missed = observed.were_missed(now);
        observed.take(now, &Data::SystemState(SystemState::empty()));
        missed
    }

    #[test]
    fn values_are_good_for_five_periods() {
        let times = |rules, line| {
            let observed = Observed::new(rules, line);
            [observed.renew_after, observed.good_for].map(|time| time.as_millis())
        };
        let periodic = UpdateRules::default();
        assert_eq!(times(periodic, None), [250, 500]);
        assert_eq!(times(periodic, Some(11_520)), [250, 500]);
        assert_eq!(times(periodic, Some(960)), [350, 700], "9600 baud");
        assert_eq!(times(periodic, Some(120)), [2792, 5585], "1200 baud");
        let on_change = UpdateRules { mode: UpdateMode::Changes, ..periodic };
        assert_eq!(times(on_change, None), [300, 1500]);
    }

    #[test]
    fn each_value_becomes_unknown_by_itself() {
        let mut observed = Observed::new(UpdateRules::default(), None);
        let start = Instant::now();
        observed.take(start, &Data::SystemState(SystemState::REFERENCED));
        observed.link_set_up(start, false);
        observed.take(start, &Data::Width(Width::new(80.0).unwrap()));
        let later = start + Duration::from_millis(400);
        observed.take(later, &Data::Speed(Speed::new(0.0).unwrap()));
        observed.take(later, &Data::Force(Force::new(1e9).unwrap()));
        let now = start + Duration::from_millis(600);
        assert_eq!(observed.values.stale(now).collect::<Vec<_>>(), ["state", "flags", "width_mm", "force_n"]);
        assert_eq!((observed.values.width_mm(now), observed.values.speed_mm_s(now)), (None, Some(0.0)));
        let report = observed.report(now).unwrap();
        assert_eq!((report.lost.len(), report.found.len()), (4, 0));
        assert!(report.lost.contains(&("force_n", Missing::Impossible)));
        assert!(report.lost.contains(&("width_mm", Missing::Silent)));
        assert!(observed.report(now).is_none(), "reported once");
        observed.take(now, &Data::Width(Width::new(12.0).unwrap()));
        assert_eq!(observed.report(now).unwrap().found, ["width_mm"]);
        // Neither homing nor a new setup makes a value known.
        let later = now + Duration::from_secs(1);
        assert!(observed.report(later).unwrap().lost.contains(&("width_mm", Missing::Silent)));
        observed.take(later, &Data::SystemState(SystemState::empty()));
        observed.link_set_up(later, false);
        assert_eq!(observed.report(later).unwrap().found, ["flags"]);
        assert!(observed.values.stale(later).any(|name| name == "force_n"));
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
        observed.requested(start, id::GET_WIDTH);
        let later = start + observed.renew_after;
        assert_eq!(observed.silent(later), None);
        observed.take(later, &Data::SystemState(SystemState::REFERENCED));
        assert_eq!(observed.silent(later), Some(id::GET_WIDTH));
    }
}
