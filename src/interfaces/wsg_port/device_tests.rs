use std::time::Duration;

use super::*;
use crate::model::{FastStopCause, LatchFields, Missing, Motion, Reason, Values};
use crate::wsg::{CustomCommand, Decoded, Decoder, GripperState, HomingDirection, SystemState};

#[path = "acknowledge_tests.rs"]
mod acknowledging;
#[path = "value_tests.rs"]
mod values;

fn rules() -> Rules {
    Rules::default()
}

fn custom_ids() -> CustomIds {
    CustomIds { read: [0xB2].into(), stream: [0xB1].into(), ..CustomIds::default() }
}

fn state() -> State {
    State {
        link: Link::Connected,
        values: Values::fixed(SystemState::REFERENCED, GripperState::Holding, [20.0, 0.0, 40.0]),
        ..State::unknown("g".parse().unwrap())
    }
}

fn latched(id: FastStopId, cause: FastStopCause) -> State {
    let latch = LatchFields {
        fast_stop_id: id,
        fast_stop_by: "somebody".into(),
        fast_stop_cause: cause,
        fast_stop_reason: Reason::truncated(""),
        fast_stop_at: jiff::Timestamp::UNIX_EPOCH,
        fast_stop_confirmed: true,
        epoch: 1,
    };
    State { latch: Some(latch), ..state() }
}

/// A virtual device with its clock and state.
struct Bench {
    device: VirtualDevice,
    now: Instant,
    state: State,
}

impl Bench {
    fn take_state(&mut self, state: GripperState) {
        self.state.values.state.take(self.now, state, Duration::from_hours(1));
    }

    fn new() -> Self {
        Self::with(&rules())
    }

    fn with(rules: &Rules) -> Self {
        Self {
            device: VirtualDevice::new("wsg:10.0.0.1".into(), rules, Arc::new(custom_ids()), 10),
            now: Instant::now(),
            state: state(),
        }
    }

    fn send(&mut self, id: u8, payload: &[u8]) {
        let mut bytes = Vec::new();
        crate::wsg::frame::encode(id, payload, &mut bytes);
        self.device.receive(self.now, &bytes, &self.state);
    }

    fn order(&mut self) -> PortOrdered {
        self.device.poll_order().expect("an order")
    }

    fn answer(&mut self, ask: PortRequest, answer: PortReply) {
        self.device.answer(self.now, ask, answer, &self.state);
    }

    /// Lets time pass and handles timeouts, as the client's I/O would.
    fn pass(&mut self, time: Duration) {
        let until = self.now + time;
        while let Some(at) = self.device.poll_timeout(self.now, &self.state).filter(|at| *at <= until) {
            self.now = self.now.max(at);
            self.device.handle_timeout(self.now, &self.state);
        }
        self.now = until;
    }

    /// Returns the ids and statuses of all sent frames.
    fn sent(&mut self) -> Vec<(u8, Status)> {
        let mut sent = Vec::new();
        while let Some(frame) = self.device.poll_frame() {
            let mut decoder = Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
            decoder.push(&frame);
            let Some(Decoded::Frame(reply)) = decoder.next() else { panic!("no frame: {frame:x?}") };
            sent.push((reply.id, Reply::parse(reply.id, reply.payload).unwrap().status()));
            assert!(!decoder.is_partial(), "one frame, one write");
        }
        sent
    }
}

const NOTHING: PortReply = PortReply::Reply(Reply::Success(Data::None));

#[test]
fn requests_run_in_order_and_stops_overtake() {
    let mut bench = Bench::new();
    bench.send(id::HOMING, &[0]);
    bench.send(id::GET_FORCE_LIMIT, &[]);
    bench.send(id::STOP, &[]);
    bench.send(id::FAST_STOP, b"whatever");
    let homing = bench.order();
    assert_eq!(homing.order, PortOrder::Command(Action::Motion(Motion::Home(HomingDirection::Default))));
    assert_eq!(bench.order().order, PortOrder::Command(Action::Stop));
    let fast_stop = bench.order();
    assert_eq!((fast_stop.order, bench.device.poll_order()), (PortOrder::FastStop, None));
    bench.answer(homing.ask, PortReply::Accepted);
    assert_eq!(bench.device.poll_order(), None, "the request waits for the FAST STOP");
    let id = FastStopId::generate();
    bench.answer(fast_stop.ask, PortReply::FastStopped(FastStop { id, confirmed: true }));
    assert_eq!(bench.order().order, PortOrder::Exchange(Command::GetForceLimit));
    assert_eq!(bench.sent(), [(id::HOMING, Status::E_CMD_PENDING), (id::FAST_STOP, Status::E_SUCCESS)]);
}

#[test]
fn stop_aborts_waiting_motions() {
    let mut bench = Bench::new();
    let mut bytes = Vec::new();
    for (id, payload) in [(id::LOOP, &b"x"[..]), (id::HOMING, &[0]), (id::STOP, &[])] {
        crate::wsg::frame::encode(id, payload, &mut bytes);
    }
    bench.device.receive(bench.now, &bytes, &bench.state);
    let (first, stop) = (bench.order(), bench.order());
    assert_eq!((first.ask.id, stop.order), (id::LOOP, PortOrder::Command(Action::Stop)));
    bench.answer(first.ask, NOTHING);
    assert_eq!(bench.device.poll_order(), None, "no motion after the Stop");
    assert_eq!(bench.sent(), [(id::LOOP, Status::E_SUCCESS), (id::HOMING, Status::E_CMD_ABORTED)]);
}

#[test]
fn motion_starts_before_a_later_stop() {
    let mut bench = Bench::new();
    let mut bytes = Vec::new();
    crate::wsg::frame::encode(id::HOMING, &[0], &mut bytes);
    crate::wsg::frame::encode(id::STOP, &[], &mut bytes);
    bench.device.receive(bench.now, &bytes, &bench.state);
    assert_eq!([bench.order().ask.id, bench.order().ask.id], [id::HOMING, id::STOP]);
}

#[test]
fn motion_after_stop_waits_for_standstill() {
    let mut bench = Bench::new();
    bench.send(id::HOMING, &[0]);
    let homing = bench.order();
    bench.answer(homing.ask, PortReply::Accepted);
    let homing = PortRequest { is_awaited: false, ..homing.ask };
    // Devices report the end of a Stop and of the stopped motion in either order.
    for stop_is_answered_first in [true, false] {
        bench.send(id::STOP, &[]);
        let stop = bench.order();
        bench.send(id::HOMING, &[1]);
        bench.send(id::GET_FORCE_LIMIT, &[]);
        assert_eq!(bench.device.poll_order(), None, "later requests do not overtake");
        let mut ends = [(stop.ask, NOTHING), (homing, PortReply::Reply(Reply::Status(Status::E_CMD_ABORTED)))];
        if !stop_is_answered_first {
            ends.reverse();
        }
        let [first, second] = ends;
        bench.answer(first.0, first.1);
        assert_eq!(bench.device.poll_order(), None);
        bench.answer(second.0, second.1);
        let next = bench.order();
        assert_eq!(next.order, PortOrder::Command(Action::Motion(Motion::Home(HomingDirection::Outer))));
        bench.answer(next.ask, PortReply::Accepted);
        let setting = bench.order();
        bench.answer(setting.ask, NOTHING);
    }
    // If nothing moves, a motion waits for the Stop alone, and another Stop aborts waiting motions.
    bench.answer(homing, PortReply::Reply(Reply::Status(Status::E_SUCCESS)));
    bench.send(id::STOP, &[]);
    bench.send(id::HOMING, &[0]);
    bench.send(id::STOP, &[]);
    let (one, other) = (bench.order(), bench.order());
    assert_eq!((one.ask.id, other.ask.id, bench.device.poll_order()), (id::STOP, id::STOP, None));
    bench.send(id::HOMING, &[0]);
    bench.answer(one.ask, NOTHING);
    assert_eq!(bench.device.poll_order(), None);
    bench.answer(other.ask, NOTHING);
    assert_eq!(bench.order().ask.id, id::HOMING);
}

#[test]
fn fast_stop_aborts_motion_waiting_after_stop() {
    let mut bench = Bench::new();
    bench.send(id::STOP, &[]);
    let stop = bench.order();
    bench.send(id::HOMING, &[0]);
    assert!(bench.device.watches(), "each new state is checked");
    bench.state = latched(FastStopId::generate(), FastStopCause::Requested);
    bench.device.handle_timeout(bench.now, &bench.state);
    // The FAST STOP is acknowledged before the Stop is answered.
    bench.state = state();
    bench.answer(stop.ask, NOTHING);
    assert_eq!(bench.device.poll_order(), None);
    assert!(!bench.device.watches());
}

#[test]
fn fast_stop_aborts_motion_waiting_for_a_reply() {
    let mut bench = Bench::new();
    bench.send(id::SET_FORCE_LIMIT, &30.0_f32.to_le_bytes());
    let setting = bench.order();
    bench.send(id::HOMING, &[0]);
    assert!(bench.device.watches(), "each new state is checked");
    bench.state = latched(FastStopId::generate(), FastStopCause::Requested);
    bench.device.handle_timeout(bench.now, &bench.state);
    // Requested in the knowledge of the FAST STOP.
    bench.send(id::RELEASE, &[50.0_f32.to_le_bytes(), 50.0_f32.to_le_bytes()].concat());
    // The FAST STOP is acknowledged before the setting is answered.
    bench.state = state();
    bench.answer(setting.ask, NOTHING);
    assert_eq!(bench.order().ask.id, id::RELEASE);
    assert_eq!(bench.sent(), [(id::SET_FORCE_LIMIT, Status::E_SUCCESS), (id::HOMING, Status::E_CMD_ABORTED)]);
}

#[test]
fn motion_behind_a_fast_stop_of_its_client_is_aborted_by_a_later_one() {
    let mut bench = Bench::new();
    bench.send(id::FAST_STOP, &[]);
    let fast_stop = bench.order();
    bench.send(id::SET_FORCE_LIMIT, &30.0_f32.to_le_bytes());
    bench.send(id::HOMING, &[0]);
    let own = FastStopId::generate();
    bench.state = latched(own, FastStopCause::Requested);
    bench.device.handle_timeout(bench.now, &bench.state);
    bench.answer(fast_stop.ask, PortReply::FastStopped(FastStop { id: own, confirmed: true }));
    let setting = bench.order();
    // Somebody acknowledges it and makes another one, which is acknowledged, too.
    for state in [state(), latched(FastStopId::generate(), FastStopCause::Requested), state()] {
        bench.state = state;
        bench.device.handle_timeout(bench.now, &bench.state);
    }
    bench.answer(setting.ask, NOTHING);
    assert_eq!(bench.device.poll_order(), None);
    assert_eq!(bench.sent().last(), Some(&(id::HOMING, Status::E_CMD_ABORTED)));
}

#[test]
fn script_blocks_nothing() {
    let mut bench = Bench::new();
    bench.send(0xB0, &[1]);
    bench.send(id::GET_SYSTEM_STATE, &[0; 3]);
    assert!(matches!(bench.order().order, PortOrder::Exchange(Command::Custom(_))));
    assert_eq!(bench.sent(), [(id::GET_SYSTEM_STATE, Status::E_SUCCESS)]);
    // A motion after a Stop does not wait for the script either, since a Stop does not end scripts.
    bench.send(id::STOP, &[]);
    let stop = bench.order();
    bench.send(id::HOMING, &[0]);
    bench.answer(stop.ask, NOTHING);
    assert_eq!(bench.order().ask.id, id::HOMING);
}

#[test]
fn streamed_requests_are_serialised_and_aborted_by_stop() {
    let mut bench = Bench::new();
    for id in [0xB1, 0xB1, 0xB0, 0xB2] {
        bench.send(id, &[1]);
    }
    let first = bench.order();
    assert_eq!((first.ask.id, bench.device.poll_order()), (0xB1, None));
    bench.send(id::STOP, &[]);
    assert_eq!(bench.order().order, PortOrder::Command(Action::Stop));
    bench.answer(first.ask, NOTHING);
    assert_eq!(bench.order().ask.id, 0xB2, "a read-only script is not a motion");
    let aborted = Status::E_CMD_ABORTED;
    assert_eq!(bench.sent(), [(0xB1, Status::E_SUCCESS), (0xB1, aborted), (0xB0, aborted)]);
}

#[test]
fn newest_request_of_a_stream_overtakes_the_waiting_ones() {
    let mut bench = Bench::new();
    for target in 0..200 {
        bench.send(0xB1, &[target]);
    }
    bench.send(id::DISCONNECT_ANNOUNCEMENT, &[]);
    let first = bench.order();
    assert_eq!((&first.order, bench.device.poll_order()), (&stream(0), None));
    bench.answer(first.ask, NOTHING);
    let newest = bench.order();
    assert_eq!(newest.order, stream(199), "the targets between are outdated");
    bench.answer(newest.ask, NOTHING);
    assert_eq!(bench.order().order, PortOrder::Release, "07h waits for one request, not for 199");
    let replies = bench.sent();
    assert_eq!(replies.len(), 200, "each request is answered");
    let succeeded = replies.iter().filter(|reply| **reply == (0xB1, Status::E_SUCCESS)).count();
    assert_eq!(succeeded, 2 + MAX_WAITING_REQUESTS);
}

fn stream(target: u8) -> PortOrder {
    PortOrder::Exchange(Command::Custom(CustomCommand::new(0xB1, vec![target]).unwrap()))
}

#[test]
fn only_stops_are_accepted_after_the_announcement() {
    let mut bench = Bench::new();
    bench.send(id::GET_GRIPPER_STATE, &[1, 10, 0]);
    bench.send(id::DISCONNECT_ANNOUNCEMENT, &[]);
    assert!(bench.device.has_announced());
    let release = bench.order();
    assert_eq!(release.order, PortOrder::Release);
    bench.send(id::GRIP, &[0; 8]);
    bench.answer(release.ask, NOTHING);
    bench.send(id::STOP, &[]);
    assert_eq!(bench.order().order, PortOrder::Command(Action::Stop));
    bench.pass(Duration::from_secs(1));
    let denied = (id::GRIP, Status::E_ACCESS_DENIED);
    let expected =
        [(id::GET_GRIPPER_STATE, Status::E_SUCCESS), (id::DISCONNECT_ANNOUNCEMENT, Status::E_SUCCESS), denied];
    assert_eq!(bench.sent(), expected, "no more updates");
}

#[test]
fn waiting_announcement_counts() {
    let mut bench = Bench::new();
    bench.send(id::HOMING, &[0]);
    bench.send(id::DISCONNECT_ANNOUNCEMENT, &[]);
    assert!(bench.device.has_announced());
}

#[test]
fn client_that_never_reads_overflows() {
    let mut bench = Bench::new();
    for _ in 0..MAX_WAITING_FRAMES {
        bench.send(id::GET_SPEED, &[0; 3]);
    }
    assert!(!bench.device.has_overflown());
    bench.send(id::GET_SPEED, &[0; 3]);
    assert!(bench.device.has_overflown());
}

#[test]
fn too_many_waiting_requests_are_an_overrun() {
    let mut bench = Bench::new();
    for _ in 0..=MAX_WAITING_REQUESTS {
        bench.send(id::LOOP, b"x");
    }
    assert_eq!(bench.sent(), []);
    bench.send(id::LOOP, b"x");
    assert_eq!(bench.sent(), [(id::LOOP, Status::E_OVERRUN)]);
    bench.send(id::FAST_STOP, &[]);
    assert_eq!((bench.order().ask.id, bench.order().order), (id::LOOP, PortOrder::FastStop), "a FAST STOP always fits");
}

#[test]
fn concurrent_fast_stops_are_combined() {
    let mut bench = Bench::new();
    for _ in 0..=MAX_WAITING_REQUESTS {
        bench.send(id::FAST_STOP, &[]);
    }
    let first = bench.order();
    assert_eq!((first.order, bench.device.poll_order()), (PortOrder::FastStop, None));
    bench.send(id::FAST_STOP, &[]);
    assert_eq!(bench.sent(), [(id::FAST_STOP, Status::E_OVERRUN)], "the earlier ones stop the gripper anyway");
    let stopped = |confirmed| PortReply::FastStopped(FastStop { id: FastStopId::generate(), confirmed });
    bench.answer(first.ask, stopped(true));
    assert_eq!(bench.sent(), [(id::FAST_STOP, Status::E_SUCCESS)]);
    // The first may have been acknowledged by now.
    let second = bench.order();
    assert_eq!((second.order, bench.device.poll_order()), (PortOrder::FastStop, None));
    bench.send(id::GET_FORCE_LIMIT, &[]);
    bench.answer(second.ask, stopped(false));
    assert_eq!(bench.sent(), [(id::FAST_STOP, Status::E_TIMEOUT)].repeat(MAX_WAITING_REQUESTS));
    assert_eq!(bench.order().ask.id, id::GET_FORCE_LIMIT);
    assert!(!bench.device.is_stopping());
}

#[test]
fn excess_stop_is_an_overrun_but_aborts_waiting_motions() {
    let mut bench = Bench::new();
    bench.send(id::LOOP, b"x");
    bench.send(id::HOMING, &[0]);
    for _ in 0..MAX_STOPS {
        bench.send(id::STOP, &[]);
    }
    let (looped, first) = (bench.order(), bench.order());
    assert_eq!(std::iter::from_fn(|| bench.device.poll_order()).count(), MAX_STOPS - 1);
    bench.send(id::STOP, &[]);
    assert_eq!((bench.device.poll_order(), bench.sent()), (None, vec![(id::STOP, Status::E_OVERRUN)]));
    bench.answer(looped.ask, NOTHING);
    assert_eq!(bench.device.poll_order(), None, "no motion after the Stops");
    bench.answer(first.ask, NOTHING);
    bench.send(id::STOP, &[]);
    assert_eq!(bench.order().ask.id, id::STOP);
}

#[test]
fn only_fast_stops_start_after_the_client_is_gone() {
    let mut bench = Bench::new();
    bench.send(id::LOOP, b"x");
    bench.send(id::HOMING, &[0]);
    bench.send(id::FAST_STOP, &[]);
    bench.send(id::FAST_STOP, &[]);
    let (looped, first) = (bench.order(), bench.order());
    bench.device.forget_waiting();
    bench.answer(looped.ask, NOTHING);
    bench.answer(first.ask, PortReply::FastStopped(FastStop { id: FastStopId::generate(), confirmed: true }));
    let second = bench.order();
    assert_eq!((second.order, bench.device.poll_order()), (PortOrder::FastStop, None));
    assert!(bench.device.is_stopping());
}

#[test]
fn silent_client_keeps_its_updates_but_no_motion() {
    let mut bench = Bench::new();
    assert!(!bench.device.is_remembered());
    bench.send(id::GET_WIDTH, &[1, 10, 0]);
    bench.send(id::LOOP, b"x");
    bench.send(id::HOMING, &[0]);
    let looped = bench.order();
    bench.device.withdraw_motions();
    bench.answer(looped.ask, NOTHING);
    assert_eq!(bench.device.poll_order(), None, "the motion is withdrawn");
    assert!(bench.device.is_remembered());
    bench.sent();
    bench.pass(Duration::from_millis(100));
    assert_eq!(bench.sent(), [(id::GET_WIDTH, Status::E_SUCCESS)].repeat(10));
}

#[test]
fn latch_is_in_the_flags_even_if_the_device_forgot_it() {
    let mut bench = Bench { state: latched(FastStopId::generate(), FastStopCause::Requested), ..Bench::new() };
    bench.send(id::GET_SYSTEM_STATE, &[0; 3]);
    let frame = bench.device.poll_frame().unwrap();
    assert_eq!(frame[8..12], (1_u32 | 1 << 12).to_le_bytes());
}
