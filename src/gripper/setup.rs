//! Setup of a link: identity, limits and state are read, one request at a time; then clients' settings are restored,
//! and automatic updates are switched on. Nothing moves, and nothing is acknowledged.

use std::collections::{BTreeSet, VecDeque};

use wsg::session::Token;
use wsg::{
    Acceleration, Command, Data, DeviceTag, Force, Reply, SoftLimits, Status, SystemInfo, SystemLimits, Updates, id,
};

/// Attempts at a request before the link is closed, or before the request is skipped if the link can do without it.
const ATTEMPTS: u8 = 3;

/// A setting of clients that a restarted device has lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, strum::Display)]
pub enum Setting {
    /// Set Acceleration (30h).
    #[strum(serialize = "acceleration")]
    Acceleration,
    /// Set Force Limit (32h).
    #[strum(serialize = "force limit")]
    ForceLimit,
    /// Set and Clear Soft Limits (34h, 36h).
    #[strum(serialize = "soft limits")]
    SoftLimits,
}

impl Setting {
    /// The setting that a request reads or changes.
    pub(super) fn of(id: u8) -> Option<Self> {
        match id {
            id::SET_ACCELERATION | id::GET_ACCELERATION => Some(Self::Acceleration),
            id::SET_FORCE_LIMIT | id::GET_FORCE_LIMIT => Some(Self::ForceLimit),
            id::SET_SOFT_LIMITS | id::GET_SOFT_LIMITS | id::CLEAR_SOFT_LIMITS => Some(Self::SoftLimits),
            _ => None,
        }
    }
}

/// Settings of clients, to be restored if the device has lost them. Overdrive is excluded: after a restart, a client
/// has to switch it on again.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Wanted {
    pub acceleration: Option<Acceleration>,
    pub force_limit: Option<Force>,
    pub soft_limits: WantedSoftLimits,
}

/// The soft limits that clients want.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) enum WantedSoftLimits {
    /// No client has changed them.
    #[default]
    AsTheyAre,
    Cleared,
    Set(SoftLimits),
}

/// Setup under way, with the information gathered so far.
#[derive(Debug, Default)]
pub(super) struct Setup {
    todo: VecDeque<Command>,
    current: Option<(Command, u8)>,
    token: Option<Token>,
    /// Serial number of the device that [`Wanted`] was set on.
    known_serial: Option<u32>,
    wanted: Wanted,
    pub system: Option<SystemInfo>,
    pub limits: Option<SystemLimits>,
    pub tag: Option<DeviceTag>,
    pub soft_limits: Option<SoftLimits>,
    /// Settings that had changed on the device and were restored.
    pub restored: Vec<Setting>,
    /// Settings of clients that the device refuses to report or to accept.
    pub lost: BTreeSet<Setting>,
    /// Whether a different device has answered than before.
    pub replaced: bool,
}

/// Next step of a setup.
#[derive(Debug, PartialEq)]
pub(super) enum Step {
    Send(Command),
    Done,
    /// The device does not answer a request that every gripper must answer.
    Failed(&'static str),
}

impl Setup {
    /// A setup that ends with the requests `switch_on`, which switch on automatic updates.
    pub(super) fn new(switch_on: impl Iterator<Item = Command>, known_serial: Option<u32>, wanted: Wanted) -> Self {
        let reads = [
            Some(Command::GetSystemInfo),
            Some(Command::GetSystemLimits),
            wanted.acceleration.map(|_| Command::GetAcceleration),
            wanted.force_limit.map(|_| Command::GetForceLimit),
            Some(Command::GetDeviceTag),
            Some(Command::GetSystemState(Updates::Off)),
            Some(Command::GetGripperState(Updates::Off)),
            Some(Command::GetSoftLimits),
        ];
        Self { todo: reads.into_iter().flatten().chain(switch_on).collect(), known_serial, wanted, ..Self::default() }
    }

    /// The next request, after the last has ended.
    pub(super) fn next(&mut self) -> Step {
        if let Some((command, attempts)) = self.current.take() {
            // If updates do not arrive, they are switched on again later.
            let allowed = if is_switch_on(&command) { 1 } else { ATTEMPTS };
            if attempts < allowed {
                self.current = Some((command.clone(), attempts + 1));
                return Step::Send(command);
            }
            if is_vital(&command) || self.concerns_wanted(&command) {
                return Step::Failed(id::name(command.id()).unwrap_or("a request"));
            }
        }
        let Some(command) = self.todo.pop_front() else { return Step::Done };
        self.current = Some((command.clone(), 1));
        Step::Send(command)
    }

    /// Whether a request reads or changes a setting that a client made.
    fn concerns_wanted(&self, command: &Command) -> bool {
        match Setting::of(command.id()) {
            Some(Setting::Acceleration) => self.wanted.acceleration.is_some(),
            Some(Setting::ForceLimit) => self.wanted.force_limit.is_some(),
            Some(Setting::SoftLimits) => self.wanted.soft_limits != WantedSoftLimits::AsTheyAre,
            None => false,
        }
    }

    pub(super) fn sent(&mut self, token: Option<Token>) {
        self.token = token;
    }

    /// Whether this is the request in flight.
    pub(super) fn is_current(&self, token: Token) -> bool {
        self.token == Some(token)
    }

    /// Takes a reply. Without one, or with an error status for a vital request, [`Setup::next`] tries again.
    pub(super) fn take(&mut self, reply: Reply) {
        let Some((command, attempts)) = self.current.take() else { return };
        match (command.id(), reply) {
            (id::GET_SOFT_LIMITS, Reply::Success(Data::SoftLimits(found))) => {
                self.compare_soft_limits(WantedSoftLimits::Set(found));
            }
            (id::GET_SOFT_LIMITS, Reply::Status(Status::E_NOT_AVAILABLE)) => {
                self.compare_soft_limits(WantedSoftLimits::Cleared);
            }
            // The device has to report its identity and its flags.
            (_, Reply::Status(_)) if is_vital(&command) => self.current = Some((command, attempts)),
            (_, Reply::Status(_)) if self.concerns_wanted(&command) => {
                // A restored value that can't be read back is assumed to be set.
                self.lost.extend(Setting::of(command.id()).filter(|setting| !self.restored.contains(setting)));
            }
            (_, Reply::Status(_)) => {}
            (_, Reply::Success(data)) => self.take_data(&command, data),
        }
    }

    /// Takes an invalid reply, such as soft limits with minus above plus (35h). No client can have set such limits. If
    /// a client has set others, those are restored; otherwise the device keeps its own.
    pub(super) fn take_invalid(&mut self) {
        if self.current.take_if(|(command, _)| *command == Command::GetSoftLimits).is_some() {
            self.compare_soft_limits(WantedSoftLimits::AsTheyAre);
        }
    }

    fn take_data(&mut self, command: &Command, data: Data) {
        match data {
            Data::SystemInfo(system) => self.identify(system),
            Data::SystemLimits(limits) => self.limits = Some(limits),
            Data::DeviceTag(tag) => self.tag = Some(tag),
            Data::Acceleration(found) => self.compare_acceleration(found),
            Data::ForceLimit(found) => self.compare_force_limit(found),
            _ => {}
        }
        // The device clamps the values that it gets, so a restored value is read back.
        let getter = match command {
            Command::SetSoftLimits(limits) => {
                self.soft_limits = Some(*limits);
                Command::GetSoftLimits
            }
            Command::ClearSoftLimits => {
                self.soft_limits = None;
                Command::GetSoftLimits
            }
            Command::SetAcceleration(_) => Command::GetAcceleration,
            Command::SetForceLimit(_) => Command::GetForceLimit,
            _ => return,
        };
        self.restored.extend(Setting::of(command.id()));
        self.todo.push_front(getter);
    }

    fn identify(&mut self, system: SystemInfo) {
        self.system = Some(system);
        self.replaced = self.known_serial.is_some_and(|known| known != system.serial_number);
        if self.replaced {
            // Settings belong to the device with the known serial number only.
            self.wanted = Wanted::default();
        }
    }

    fn compare_acceleration(&mut self, found: Acceleration) {
        match self.wanted.acceleration {
            Some(wanted) if wanted != found && !self.restored.contains(&Setting::Acceleration) => {
                self.todo.push_front(Command::SetAcceleration(wanted));
            }
            wanted => self.wanted.acceleration = wanted.map(|_| found),
        }
    }

    /// Restores a force limit, but at most the nominal force, because Overdrive Mode is not restored.
    fn compare_force_limit(&mut self, found: Force) {
        let Some(wanted) = self.wanted.force_limit else { return };
        let nominal = self.limits.map(|limits| limits.nominal_force);
        let allowed = nominal.filter(|nominal| *nominal < wanted).unwrap_or(wanted);
        if wanted != found && allowed != found && !self.restored.contains(&Setting::ForceLimit) {
            self.todo.push_front(Command::SetForceLimit(allowed));
        } else {
            self.wanted.force_limit = Some(found);
        }
    }

    /// Takes the device's soft limits; [`WantedSoftLimits::AsTheyAre`] if they are unreadable.
    fn compare_soft_limits(&mut self, found: WantedSoftLimits) {
        self.soft_limits = if let WantedSoftLimits::Set(limits) = found { Some(limits) } else { None };
        let is_restored = self.restored.contains(&Setting::SoftLimits);
        match (self.wanted.soft_limits, found) {
            (WantedSoftLimits::AsTheyAre, _) => {}
            (wanted, found) if wanted == found => {}
            (WantedSoftLimits::Cleared, _) if !is_restored => self.todo.push_front(Command::ClearSoftLimits),
            (WantedSoftLimits::Set(wanted), _) if !is_restored => {
                self.todo.push_front(Command::SetSoftLimits(wanted));
            }
            (WantedSoftLimits::Set(_), WantedSoftLimits::Set(_)) => self.wanted.soft_limits = found,
            _ => {
                self.lost.insert(Setting::SoftLimits);
            }
        }
    }

    pub(super) fn wanted(&self) -> Wanted {
        self.wanted
    }
}

/// Whether the link is useless without a reply: the device's identity, and its flags.
fn is_vital(command: &Command) -> bool {
    matches!(command, Command::GetSystemInfo | Command::GetSystemState(Updates::Off))
}

/// Whether a request switches on automatic updates.
fn is_switch_on(command: &Command) -> bool {
    matches!(
        command,
        Command::GetSystemState(Updates::On { .. })
            | Command::GetGripperState(Updates::On { .. })
            | Command::GetWidth(_)
            | Command::GetSpeed(_)
            | Command::GetForce(_)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::automatic_updates;
    use model::UpdateRules;
    use wsg::{DeviceType, Firmware, Speed, SystemState, Width};

    fn switch_on() -> impl Iterator<Item = Command> {
        automatic_updates::switch_on_all(UpdateRules::default(), None)
    }

    fn system(serial_number: u32) -> Reply {
        let info = SystemInfo {
            device_type: DeviceType::Wsg50,
            hardware_revision: 1,
            firmware: Firmware(0x4020),
            serial_number,
        };
        Reply::Success(Data::SystemInfo(info))
    }

    /// Answers each request with `reply`, and returns the sent requests.
    fn run(mut setup: Setup, mut reply: impl FnMut(&Command) -> Option<Reply>) -> (Setup, Vec<Command>, Step) {
        let mut sent = Vec::new();
        loop {
            match setup.next() {
                Step::Send(command) => {
                    if let Some(reply) = reply(&command) {
                        setup.take(reply);
                    }
                    sent.push(command);
                }
                end => return (setup, sent, end),
            }
        }
    }

    #[allow(clippy::unnecessary_wraps, reason = "other reply functions return None")]
    fn forgetful(command: &Command) -> Option<Reply> {
        Some(match command {
            Command::GetSystemInfo => system(7),
            Command::GetAcceleration => Reply::Success(Data::Acceleration(Acceleration::new(500.0).unwrap())),
            Command::GetForceLimit => Reply::Success(Data::ForceLimit(Force::new(40.0).unwrap())),
            Command::GetSoftLimits => Reply::Status(Status::E_NOT_AVAILABLE),
            Command::GetSystemState(Updates::Off) => Reply::Success(Data::SystemState(SystemState::REFERENCED)),
            _ => Reply::Success(Data::None),
        })
    }

    fn wanted() -> Wanted {
        Wanted { force_limit: Some(Force::new(10.0).unwrap()), ..Wanted::default() }
    }

    #[test]
    fn refused_settings_are_lost_and_not_reported_as_restored() {
        for refused in [id::GET_FORCE_LIMIT, id::SET_FORCE_LIMIT] {
            let (setup, _, end) = run(Setup::new(switch_on(), Some(7), wanted()), |command| {
                let refusal = Reply::Status(Status::E_INSUFFICIENT_RESOURCES);
                if command.id() == refused { Some(refusal) } else { forgetful(command) }
            });
            assert_eq!(end, Step::Done);
            assert!(setup.restored.is_empty() && setup.lost.contains(&Setting::ForceLimit), "{refused:02X}h");
        }
    }

    #[test]
    fn unanswered_settings_fail_the_link() {
        let (_, _, end) = run(Setup::new(switch_on(), Some(7), wanted()), |command| {
            if command.id() == id::SET_FORCE_LIMIT { None } else { forgetful(command) }
        });
        assert_eq!(end, Step::Failed("SetForceLimit"));
    }

    #[test]
    fn error_status_for_identity_or_flags_fails_the_link() {
        for vital in [id::GET_SYSTEM_INFO, id::GET_SYSTEM_STATE] {
            let (_, _, end) = run(Setup::new(switch_on(), None, Wanted::default()), |command| {
                let refusal = Reply::Status(Status::E_NOT_AVAILABLE);
                if command.id() == vital { Some(refusal) } else { forgetful(command) }
            });
            assert!(matches!(end, Step::Failed(_)), "{vital:02X}h: {end:?}");
        }
    }

    #[test]
    fn unanswered_switch_on_is_tried_once() {
        let (_, sent, end) = run(Setup::new(switch_on(), None, Wanted::default()), |command| {
            if command.id() == id::GET_WIDTH { None } else { forgetful(command) }
        });
        assert_eq!((sent.len(), end), (11, Step::Done));
    }

    #[test]
    fn first_connect_reads_and_switches_updates_on() {
        let (_, sent, end) = run(Setup::new(switch_on(), None, Wanted::default()), forgetful);
        let ids: Vec<_> = sent.iter().map(Command::id).collect();
        assert_eq!(ids, [0x50, 0x53, 0x52, 0x40, 0x41, 0x35, 0x40, 0x41, 0x43, 0x44, 0x45]);
        assert_eq!(end, Step::Done);
    }

    #[test]
    fn only_the_same_device_gets_its_settings_again() {
        let wanted = Wanted {
            acceleration: Some(Acceleration::new(2000.0).unwrap()),
            force_limit: Some(Force::new(40.0).unwrap()),
            soft_limits: WantedSoftLimits::Cleared,
        };
        let (setup, sent, _) = run(Setup::new(switch_on(), Some(7), wanted), forgetful);
        assert_eq!(setup.restored, [Setting::Acceleration], "the force limit is unchanged");
        assert!(sent.contains(&Command::SetAcceleration(Acceleration::new(2000.0).unwrap())));
        let (setup, sent, _) = run(Setup::new(switch_on(), Some(8), wanted), forgetful);
        assert!(setup.replaced && setup.restored.is_empty());
        assert!(!sent.iter().any(|command| command.id() == id::SET_ACCELERATION));
    }

    /// Replies of a device that keeps its settings, and clamps the force limit to `most_n`.
    fn clamping(mut force_n: f32, most_n: f32) -> impl FnMut(&Command) -> Option<Reply> {
        let limits = SystemLimits {
            stroke: Width::ZERO,
            min_speed: Speed::ZERO,
            max_speed: Speed::ZERO,
            min_acceleration: Acceleration::ZERO,
            max_acceleration: Acceleration::ZERO,
            min_force: Force::ZERO,
            nominal_force: Force::new(80.0).unwrap(),
            overdrive_force: Force::new(120.0).unwrap(),
        };
        move |command| match command {
            Command::SetForceLimit(force) => {
                force_n = force.n().min(most_n);
                Some(Reply::Success(Data::None))
            }
            Command::GetForceLimit => Some(Reply::Success(Data::ForceLimit(Force::new(force_n).unwrap()))),
            Command::GetSystemLimits => Some(Reply::Success(Data::SystemLimits(limits))),
            command => forgetful(command),
        }
    }

    #[test]
    fn force_limit_is_restored_up_to_nominal_and_read_back() {
        let force = |n| Some(Force::new(n).unwrap());
        // Inputs: the wanted limit, the limit found, and the device's maximum. Results: the limit sent, and the limit
        // known afterwards.
        for (wanted, found, most, sent, known) in [
            (100.0, 80.0, 120.0, None, 80.0),
            (100.0, 100.0, 120.0, None, 100.0),
            (100.0, 40.0, 120.0, force(80.0), 80.0),
            (60.0, 40.0, 120.0, force(60.0), 60.0),
            (60.0, 40.0, 50.0, force(60.0), 50.0),
        ] {
            let wanted = Wanted { force_limit: force(wanted), ..Wanted::default() };
            let (setup, frames, end) = run(Setup::new(switch_on(), Some(7), wanted), clamping(found, most));
            let set: Vec<_> = frames.iter().filter(|command| command.id() == id::SET_FORCE_LIMIT).collect();
            assert_eq!(set, sent.map(Command::SetForceLimit).iter().collect::<Vec<_>>(), "found {found}");
            assert_eq!((setup.wanted().force_limit, end), (force(known), Step::Done), "found {found}");
            assert!(setup.lost.is_empty());
        }
    }

    #[test]
    fn reversed_soft_limits_are_replaced_by_the_limits_of_a_client() {
        let width = |mm| Width::new(mm).unwrap();
        let limits = SoftLimits::new(width(10.0), width(60.0)).unwrap();
        for (soft_limits, mend) in [
            (WantedSoftLimits::AsTheyAre, None),
            (WantedSoftLimits::Cleared, Some(Command::ClearSoftLimits)),
            (WantedSoftLimits::Set(limits), Some(Command::SetSoftLimits(limits))),
        ] {
            let mut setup = Setup::new(switch_on(), Some(7), Wanted { soft_limits, ..Wanted::default() });
            let mut sent = Vec::new();
            while let Step::Send(command) = setup.next() {
                let is_mended = mend.as_ref().is_some_and(|mend| sent.contains(mend));
                match &command {
                    Command::GetSoftLimits if !is_mended => setup.take_invalid(),
                    Command::GetSoftLimits if mend == Some(Command::SetSoftLimits(limits)) => {
                        setup.take(Reply::Success(Data::SoftLimits(limits)));
                    }
                    command => setup.take(forgetful(command).unwrap()),
                }
                sent.push(command);
            }
            assert_eq!(
                sent.iter().find(|command| Setting::of(command.id()).is_some_and(|_| !command.is_read())),
                mend.as_ref()
            );
            assert!(setup.lost.is_empty() && setup.current.is_none(), "{soft_limits:?}");
        }
    }

    #[test]
    fn unanswered_identity_fails_the_link() {
        let (_, sent, end) = run(Setup::new(switch_on(), None, Wanted::default()), |_| None);
        assert_eq!(sent.len(), 3, "each request is tried three times");
        assert_eq!(end, Step::Failed("GetSystemInfo"));
    }
}
