//! The schedule of a seed: all steps are drawn in advance.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use rand::RngExt;
use rand::rngs::SmallRng;
use sim::{BrokenGetter, Change, FaultKind, Part};
use wsg::id;

use super::leases::LeaseAsk;
use super::servo::ServoAsk;

#[derive(Debug, Clone)]
pub enum Step {
    /// A change of the device or its surroundings.
    Change(Change),
    /// A client request.
    Client(Ask),
    /// Delays everything that the device sends by this much, in order.
    Stall(Duration),
    /// Delays all requests by this much, in order.
    StallRequests(Duration),
    /// Delivers old datagrams once more, in both directions.
    LateDatagrams,
}

/// A client request.
#[derive(Debug, Clone, Copy)]
pub enum Ask {
    Home,
    Move,
    MoveRelative,
    Grip { with_force: bool },
    Release,
    Repeat,
    Stop,
    Cancel,
    FastStop,
    Acknowledge { stale: bool },
    Set,
    Read,
    Custom,
    Stream,
    Servo(ServoAsk),
    Loop,
    Lease(LeaseAsk),
}

/// Steps of one seed, in order.
pub struct Schedule(VecDeque<(Duration, Step)>);

impl Schedule {
    pub fn new(rng: &mut SmallRng, length: Duration) -> Self {
        // Most users home first.
        let mut steps = vec![(Duration::from_millis(300), Step::Client(Ask::Home))];
        let at = |rng: &mut SmallRng| Duration::from_micros(rng.random_range(0..length.as_micros() as u64));
        for _ in 0..rng.random_range(10..40) {
            let ask = Step::Client(ask(rng));
            steps.push((at(rng), ask));
        }
        for _ in 0..rng.random_range(0..8) {
            let begins = at(rng);
            let lasts = Duration::from_millis(rng.random_range(1..3000));
            let (change, undone) = change(rng);
            steps.push((begins, Step::Change(change)));
            if let Some(undone) = undone {
                steps.push((begins + lasts, Step::Change(undone)));
            }
        }
        for _ in 0..rng.random_range(0..3) {
            let fault = Step::Change(fault(rng));
            steps.push((at(rng), fault));
        }
        if rng.random_bool(0.2) {
            // The reply to the first command comes after its time-out, and must not answer the second.
            let begins = at(rng);
            let lasts = Duration::from_millis(rng.random_range(1100..1450));
            steps.push((begins, Step::Stall(lasts)));
            for after in [Duration::from_millis(5), Duration::from_millis(1050)] {
                steps.push((begins + after, Step::Client(Ask::Custom)));
            }
        }
        if rng.random_bool(0.2) {
            let begins = at(rng);
            let every = Duration::from_millis(rng.random_range(5..40));
            steps.extend((0..50).map(|n| (begins + n * every, Step::Client(Ask::Stream))));
        }
        if rng.random_bool(0.5) {
            let begins = at(rng);
            steps.extend(steering(rng, begins));
        }
        if rng.random_bool(0.15) {
            let begins = at(rng);
            let lasts = Duration::from_millis(rng.random_range(500..5000));
            steps.push((begins, Step::StallRequests(lasts)));
            if rng.random_bool(0.5) {
                steps.push((begins, Step::Stall(lasts)));
            }
            let after = Duration::from_millis(rng.random_range(1..200));
            steps.push((begins + after, Step::Client(ask(rng))));
        }
        for _ in 0..rng.random_range(0..3) {
            steps.push((at(rng), Step::LateDatagrams));
        }
        steps.sort_by_key(|(at, _)| *at);
        Self(steps.into())
    }

    /// Returns a random change of the device.
    pub fn any_change(rng: &mut SmallRng) -> Change {
        change(rng).0
    }

    pub fn next_at(&self, start: Instant) -> Option<Instant> {
        self.0.front().map(|(at, _)| start + *at)
    }

    pub fn pop(&mut self, elapsed: Duration) -> Option<Step> {
        (self.0.front()?.0 <= elapsed).then(|| self.0.pop_front().map(|(_, step)| step))?
    }

    /// Changes that end all faults.
    pub fn healing() -> impl Iterator<Item = Change> {
        [
            Change::DisarmFaults,
            Change::Silent { on: false },
            Change::RefuseConnections { on: false },
            Change::Cool,
            Change::CurrentFault { on: false, clears_after_ms: None },
            Change::PowerFault { on: false },
            Change::FingerOverCurrent { finger: 1, on: false },
            Change::FingerCommunicationFault { finger: 1, on: false },
            Change::RemoveObstacle,
            Change::MendGetters,
        ]
        .into_iter()
    }
}

/// Targets at 30 to 100 Hz of a client that makes the gripper ready, begins anew now and then, pauses, and goes on after
/// the end of its session.
fn steering(rng: &mut SmallRng, begins: Duration) -> Vec<(Duration, Step)> {
    let mut steps = Vec::new();
    let mut add = |at, ask| steps.push((at, Step::Client(ask)));
    let acknowledge = Ask::Acknowledge { stale: false };
    add(begins, acknowledge);
    add(begins + Duration::from_millis(50), Ask::Home);
    let mut at = begins + Duration::from_millis(rng.random_range(500..3000));
    add(at, Ask::Servo(ServoAsk::Start));
    for _ in 0..rng.random_range(20..200) {
        at += Duration::from_micros(rng.random_range(10_000..33_000));
        let ask = match rng.random_range(0..40) {
            0..3 => ServoAsk::Start,
            3 => {
                add(at, acknowledge);
                at += Duration::from_millis(100);
                ServoAsk::Start
            }
            4 => ServoAsk::Stop,
            5 | 6 => ServoAsk::Follow,
            7 => ServoAsk::AimByAnother,
            8 => {
                at += Duration::from_millis(rng.random_range(50..900));
                ServoAsk::Start
            }
            9 => {
                at += Duration::from_millis(rng.random_range(20..400));
                ServoAsk::Aim
            }
            _ => ServoAsk::Aim,
        };
        add(at, Ask::Servo(ask));
    }
    steps
}

fn ask(rng: &mut SmallRng) -> Ask {
    match rng.random_range(0..32) {
        0..3 => Ask::Home,
        6 => Ask::MoveRelative,
        7..11 => Ask::Grip { with_force: rng.random_bool(0.3) },
        11..13 => Ask::Release,
        13 => Ask::Repeat,
        14 => Ask::Stop,
        15 => Ask::Cancel,
        16 => Ask::FastStop,
        17..20 => Ask::Acknowledge { stale: rng.random_bool(0.1) },
        20 => Ask::Set,
        21 => Ask::Read,
        22 => Ask::Custom,
        23 => Ask::Loop,
        24..27 => Ask::Lease(LeaseAsk::Take { force: rng.random_bool(0.2) }),
        27 => Ask::Lease(LeaseAsk::HandOver),
        28 => Ask::Lease(LeaseAsk::Renew),
        29 => Ask::Lease(LeaseAsk::Release { stale: rng.random_bool(0.3) }),
        30 => Ask::Lease(LeaseAsk::Lose),
        _ => Ask::Move,
    }
}

/// Returns a change, and its reversal, if it has one.
fn change(rng: &mut SmallRng) -> (Change, Option<Change>) {
    match rng.random_range(0..20) {
        0 => (Change::PlacePart(Part::outside(rng.random_range(5.0..40.0))), None),
        1 => (Change::TakePart, None),
        2 => (Change::SlipPart, None),
        3 => (Change::PlaceObstacle { width_mm: rng.random_range(5.0..60.0) }, Some(Change::RemoveObstacle)),
        4 => (Change::Overheat { temperature_c: 120.0 }, Some(Change::Cool)),
        5 => (Change::CurrentFault { on: true, clears_after_ms: Some(rng.random_range(1..2000)) }, None),
        6 => (Change::PowerFault { on: true }, Some(Change::PowerFault { on: false })),
        7 => {
            let fault = |on| Change::FingerOverCurrent { finger: 1, on };
            (fault(true), Some(fault(false)))
        }
        8 => (Change::MoveBySomebody { width_mm: rng.random_range(5.0..40.0), speed_mm_s: 50.0 }, None),
        9 => (Change::SetFastStop, None),
        10 => (Change::FailScript, Some(Change::StartScript)),
        11 => {
            let ready_after_ms = rng.random_range(1..3000);
            (Change::Reboot { ready_after_ms, mid_frame: rng.random_bool(0.5) }, None)
        }
        12 => (Change::Silent { on: true }, Some(Change::Silent { on: false })),
        13 => (Change::HalfOpen { on: true }, None),
        14 => (Change::RefuseConnections { on: true }, Some(Change::RefuseConnections { on: false })),
        15 => (Change::CutConnection, None),
        16 | 17 => (broken_getter(rng), Some(Change::MendGetters)),
        _ => (fault(rng), None),
    }
}

fn broken_getter(rng: &mut SmallRng) -> Change {
    let getters =
        [id::GET_SYSTEM_STATE, id::GET_GRIPPER_STATE, id::GET_WIDTH, id::GET_SPEED, id::GET_FORCE, id::GET_TEMPERATURE];
    let code = rng.random_range(1..40);
    let hows = [BrokenGetter::Silent, BrokenGetter::Status { code }, BrokenGetter::NotANumber];
    Change::BreakGetter { id: getters[rng.random_range(0..getters.len())], how: hows[rng.random_range(0..hows.len())] }
}

fn fault(rng: &mut SmallRng) -> Change {
    let kinds = [
        FaultKind::CorruptByte,
        FaultKind::CorruptChecksum,
        FaultKind::CorruptSize,
        FaultKind::HalfFrame,
        FaultKind::Garbage,
        FaultKind::PreambleRun,
        FaultKind::FalsePreamble,
        FaultKind::SplitBytes,
        FaultKind::JoinFrames,
        FaultKind::DropConnection,
        FaultKind::NoReply,
        FaultKind::Status { code: rng.random_range(0..40) },
        FaultKind::FinalStatus { code: rng.random_range(0..40) },
        FaultKind::FinalTwice,
        FaultKind::FinalLate { by_ms: rng.random_range(1..5000) },
        FaultKind::FinalWithoutPending,
        FaultKind::FinalBeforePending,
        FaultKind::PendingWithoutFinal,
        FaultKind::SilenceAfterAccept,
    ];
    let kind = kinds[rng.random_range(0..kinds.len())];
    let targets = [id::HOMING, id::PRE_POSITION, id::GRIP, id::RELEASE, id::STOP, id::FAST_STOP, id::GET_SYSTEM_STATE];
    // Faults in a result need a command with a result; others can affect any command.
    let target = rng.random_bool(0.8).then(|| targets[rng.random_range(0..targets.len())]);
    Change::Fault { kind, id: target, times: rng.random_range(1..4) }
}
