mod finger_power;
mod late;
mod opaque;

use super::*;
use crate::reply::{Data, Reply};
use crate::{CustomCommand, Force, GripperState, LoopData, Speed, Status, SystemState, Updates, Width};

const ANSWER: Duration = Duration::from_millis(100);
const RESULT: Duration = Duration::from_secs(5);
const NOTHING: [u8; 0] = [];
const NO_EVENTS: [SessionEvent; 0] = [];

/// A session on a virtual clock, with helpers that act as its device.
struct Rig {
    session: Session,
    now: Instant,
}

impl Rig {
    fn new() -> Self {
        Self::on_a_line(None)
    }

    fn on_a_line(bytes_per_second: Option<u32>) -> Self {
        let frame_gap = Duration::from_millis(50);
        Self::with(SessionConfig { bytes_per_second, frame_gap, may_duplicate: false, nonce_seed: 7 })
    }

    fn on_datagrams() -> Self {
        let frame_gap = Duration::from_millis(50);
        Self::with(SessionConfig { bytes_per_second: None, frame_gap, may_duplicate: true, nonce_seed: 7 })
    }

    fn with(config: SessionConfig) -> Self {
        let now = Instant::now();
        Self { session: Session::new(config, now), now }
    }

    fn submit(&mut self, command: Command) -> Token {
        self.session.submit(self.now, Request { command, reply_within: ANSWER, result_within: RESULT }).unwrap()
    }

    fn refused(&mut self, command: Command) -> NotTaken {
        let request = Request { command, reply_within: ANSWER, result_within: RESULT };
        self.session.submit(self.now, request).unwrap_err()
    }

    /// Ids of the frames handed out now.
    fn written(&mut self) -> Vec<u8> {
        let mut ids = Vec::new();
        let mut out = Vec::new();
        while self.session.poll_transmit(self.now, &mut out) {
            ids.push(out[3]);
            out.clear();
        }
        ids
    }

    /// Device's echo of the Loop handed out now.
    fn echo_of_written_loop(&mut self) -> Vec<u8> {
        let mut out = Vec::new();
        assert!(self.session.poll_transmit(self.now, &mut out), "the session sends a Loop");
        assert_eq!(out[3], id::LOOP);
        let mut echo = Vec::new();
        Reply::Success(Data::Loop(out[6..out.len() - 2].to_vec())).encode(id::LOOP, &mut echo);
        echo
    }

    fn reply(&mut self, id: u8, reply: &Reply) {
        let mut bytes = Vec::new();
        reply.encode(id, &mut bytes);
        self.session.receive(self.now, &bytes);
    }

    fn status(&mut self, id: u8, status: Status) {
        let reply = if status == Status::E_SUCCESS { Reply::Success(Data::None) } else { Reply::Status(status) };
        self.reply(id, &reply);
    }

    fn flags(&mut self, flags: SystemState) {
        self.reply(id::GET_SYSTEM_STATE, &Reply::Success(Data::SystemState(flags)));
    }

    fn pass(&mut self, time: Duration) {
        self.now += time;
        self.session.handle_timeout(self.now);
    }

    fn events(&mut self) -> Vec<SessionEvent> {
        std::iter::from_fn(|| self.session.poll_event()).collect()
    }
}

fn grip() -> Command {
    Command::Grip { width: Width::new(20.0).unwrap(), speed: Speed::new(50.0).unwrap() }
}

fn done() -> End {
    End::Reply(Reply::Success(Data::None))
}

#[test]
fn fast_stop_overtakes_stop_and_stop_overtakes_the_rest() {
    let mut rig = Rig::new();
    rig.submit(grip());
    rig.submit(Command::GetTemperature);
    rig.submit(Command::Stop);
    rig.submit(Command::FastStop);
    assert_eq!(rig.written(), [id::FAST_STOP, id::STOP, id::GRIP, id::GET_TEMPERATURE]);
}

#[test]
fn one_request_per_id_is_in_flight() {
    let mut rig = Rig::new();
    let first = rig.submit(Command::GetTemperature);
    let second = rig.submit(Command::GetTemperature);
    rig.submit(Command::GetSystemInfo);
    assert_eq!(rig.written(), [id::GET_TEMPERATURE, id::GET_SYSTEM_INFO]);
    rig.status(id::GET_TEMPERATURE, Status::E_NOT_AVAILABLE);
    let refused = |token| SessionEvent::Ended(token, End::Reply(Reply::Status(Status::E_NOT_AVAILABLE)));
    assert_eq!(rig.events(), [refused(first)]);
    assert_eq!(rig.written(), [id::GET_TEMPERATURE]);
    rig.status(id::GET_TEMPERATURE, Status::E_NOT_AVAILABLE);
    assert_eq!(rig.events(), [refused(second)]);
}

#[test]
fn two_step_command_is_accepted_then_ends() {
    let mut rig = Rig::new();
    let token = rig.submit(grip());
    rig.written();
    rig.status(id::GRIP, Status::E_CMD_PENDING);
    assert_eq!(rig.events(), [SessionEvent::Accepted(token)]);
    rig.pass(RESULT * 9 / 10);
    assert_eq!(rig.events(), NO_EVENTS);
    rig.status(id::GRIP, Status::E_CMD_FAILED);
    assert_eq!(rig.events(), [SessionEvent::Ended(token, End::Reply(Reply::Status(Status::E_CMD_FAILED)))]);
}

#[test]
fn result_before_pending_is_late() {
    let mut rig = Rig::new();
    let token = rig.submit(grip());
    rig.written();
    rig.status(id::GRIP, Status::E_SUCCESS);
    assert_eq!(rig.events(), NO_EVENTS);
    rig.status(id::GRIP, Status::E_CMD_PENDING);
    rig.status(id::GRIP, Status::E_SUCCESS);
    assert_eq!(rig.events(), [SessionEvent::Accepted(token), SessionEvent::Ended(token, done())]);
    assert_eq!(rig.session.counters().late_replies, 1);
}

#[test]
fn rejected_motion_ends_at_once() {
    let mut rig = Rig::new();
    let token = rig.submit(grip());
    rig.written();
    rig.status(id::GRIP, Status::E_ACCESS_DENIED);
    assert_eq!(rig.events(), [SessionEvent::Ended(token, End::Reply(Reply::Status(Status::E_ACCESS_DENIED)))]);
}

#[test]
fn fast_stop_and_stop_never_wait_for_an_echo() {
    let mut rig = Rig::new();
    rig.submit(Command::FastStop);
    rig.submit(Command::Stop);
    rig.written();
    rig.pass(ANSWER);
    rig.submit(Command::Stop);
    rig.submit(Command::FastStop);
    assert_eq!(rig.written()[..2], [id::FAST_STOP, id::STOP]);
}

#[test]
fn pending_stops_time_out_like_unanswered_ones() {
    for (command, id) in [(Command::FastStop, id::FAST_STOP), (Command::Stop, id::STOP)] {
        let mut rig = Rig::new();
        let token = rig.submit(command.clone());
        rig.written();
        rig.pass(Duration::from_millis(1));
        rig.status(id, Status::E_CMD_PENDING);
        rig.pass(ANSWER);
        assert_eq!(
            rig.events(),
            [SessionEvent::Accepted(token), SessionEvent::Ended(token, End::NoResult { stopped: false })]
        );
        rig.submit(command);
        assert_eq!(rig.written()[..1], [id]);
    }
}

#[test]
fn nothing_that_a_waiting_stop_would_undo_is_written_before_it() {
    let script = || Command::Custom(CustomCommand::new(0xB0, vec![1]).unwrap());
    let acknowledge = (Command::FastStop, Command::AcknowledgeFastStop);
    for (stop, undone) in [(Command::Stop, grip()), (Command::Stop, script()), acknowledge] {
        for is_answered in [true, false] {
            let (mut rig, id) = (Rig::new(), stop.id());
            rig.submit(stop.clone());
            assert_eq!(rig.written(), [id]);
            rig.pass(ANSWER / 2);
            rig.submit(stop.clone());
            rig.submit(undone.clone());
            rig.submit(Command::GetTemperature);
            assert_eq!(rig.written(), [id::GET_TEMPERATURE]);
            if is_answered {
                rig.status(id, Status::E_SUCCESS);
            } else {
                rig.pass(ANSWER / 2);
            }
            assert_eq!(rig.written()[..2], [id, undone.id()]);
        }
    }
}

#[test]
fn stop_shortens_wait_for_motion_result() {
    let mut rig = Rig::new();
    let motion = rig.submit(grip());
    rig.written();
    rig.status(id::GRIP, Status::E_CMD_PENDING);
    let stop = rig.submit(Command::Stop);
    rig.written();
    rig.status(id::STOP, Status::E_SUCCESS);
    assert_eq!(rig.events(), [SessionEvent::Accepted(motion), SessionEvent::Ended(stop, done())]);
    rig.pass(ABORT_GRACE);
    assert_eq!(rig.events(), [SessionEvent::Ended(motion, End::NoResult { stopped: true })]);
}

#[test]
fn unwritten_request_ends_at_its_deadline() {
    let mut rig = Rig::new();
    let token = rig.submit(Command::GetTemperature);
    rig.pass(ANSWER);
    assert_eq!(
        rig.events(),
        [SessionEvent::Ended(token, End::Unanswered { written: false, stopped: false, waited: ANSWER })]
    );
    assert_eq!(rig.written(), NOTHING);
}

#[test]
fn a_withdrawn_request_is_never_written() {
    let mut rig = Rig::new();
    let token = rig.submit(grip());
    assert!(rig.session.withdraw(token));
    assert_eq!(rig.written(), NOTHING);
    let token = rig.submit(grip());
    rig.written();
    assert!(!rig.session.withdraw(token), "too late");
}

#[test]
fn update_ends_the_request_that_enabled_it() {
    let mut rig = Rig::new();
    let token = rig.submit(Command::GetGripperState(Updates::On { on_change: false, period_ms: 10 }));
    rig.written();
    let data = Data::GripperState(GripperState::Idle);
    rig.reply(id::GET_GRIPPER_STATE, &Reply::Success(data.clone()));
    let end = End::Reply(Reply::Success(data.clone()));
    assert_eq!(rig.events(), [SessionEvent::Update(data.clone()), SessionEvent::Ended(token, end)]);
    rig.reply(id::GET_GRIPPER_STATE, &Reply::Success(data.clone()));
    assert_eq!(rig.events(), [SessionEvent::Update(data)]);
    assert_eq!(rig.session.counters().stray_replies, 0);
}

#[test]
fn invalid_reply_ends_its_request_except_for_motions() {
    let mut rig = Rig::new();
    let token = rig.submit(Command::GetSystemLimits);
    rig.submit(grip());
    rig.written();
    rig.reply(id::GET_SYSTEM_LIMITS, &Reply::Success(Data::None));
    rig.reply(id::GRIP, &Reply::Success(Data::GripperState(GripperState::Idle)));
    assert!(matches!(rig.events()[..], [SessionEvent::Ended(ended, End::Invalid(_))] if ended == token));
    assert_eq!(rig.session.decoder_counters().oversized, 1, "the reply to a grip has no data");
}

#[test]
fn silent_device_is_probed_and_partial_frame_given_up() {
    let mut rig = Rig::new();
    rig.session.receive(rig.now, &[0xAA, 0xAA, 0xAA, id::LOOP]);
    assert_eq!(rig.session.poll_timeout(), Some(rig.now + Duration::from_millis(50)));
    rig.pass(Duration::from_millis(50));
    assert_eq!(rig.session.decoder_counters().cut_short, 1);
    rig.pass(PROBE_AFTER);
    assert_eq!(rig.written(), [id::LOOP]);
    rig.pass(Duration::from_millis(400));
    assert_eq!(rig.written(), [id::LOOP], "again, with another nonce");
}

#[test]
fn long_request_is_rejected_on_slow_line_while_moving() {
    let mut rig = Rig::on_a_line(Some(960));
    let long = Request {
        command: Command::Loop(LoopData::new(vec![0; 256]).unwrap()),
        reply_within: ANSWER,
        result_within: RESULT,
    };
    assert!(rig.session.submit(rig.now, long.clone()).is_ok());
    rig.flags(SystemState::MOVING);
    assert_eq!(rig.session.submit(rig.now, long), Err(NotTaken::LineTime { line_ms: 275 }));
    assert_eq!(rig.written(), NOTHING, "the fingers have begun to move since the request was taken");
}

#[test]
fn motion_without_a_known_end_counts_as_moving() {
    let mut rig = Rig::on_a_line(Some(960));
    let long = || Command::Loop(LoopData::new(vec![0; 256]).unwrap());
    rig.submit(grip());
    rig.submit(long());
    assert_eq!(rig.written(), [id::GRIP]);
    assert_eq!(rig.refused(long()), NotTaken::LineTime { line_ms: 275 });
    rig.status(id::GRIP, Status::E_ACCESS_DENIED);
    assert_eq!(rig.written(), [id::LOOP], "the motion was refused");

    rig.submit(grip());
    rig.written();
    rig.pass(Duration::from_secs(1));
    assert_eq!(rig.refused(long()), NotTaken::LineTime { line_ms: 275 });
}

#[test]
fn script_before_a_stop_is_not_written_after_it() {
    let mut rig = Rig::new();
    for _ in 0..2 {
        rig.submit(Command::Stop);
    }
    assert_eq!(rig.written(), [id::STOP]);
    rig.submit(Command::Custom(CustomCommand::new(0xB0, vec![1]).unwrap()));
    rig.submit(Command::Stop);
    assert_eq!(rig.written(), NOTHING);
    rig.status(id::STOP, Status::E_SUCCESS);
    assert_eq!(rig.written(), [id::STOP, 0xB0, id::STOP]);
}

#[test]
fn unanswered_stop_does_not_delay_the_stop_of_a_later_start() {
    let script = || Command::Custom(CustomCommand::new(0xB0, vec![1]).unwrap());
    let acknowledge = (Command::FastStop, Command::AcknowledgeFastStop);
    for (stop, start) in [(Command::Stop, grip()), (Command::Stop, script()), acknowledge] {
        let (mut rig, id) = (Rig::new(), stop.id());
        let first = rig.submit(stop.clone());
        rig.written();
        rig.submit(start.clone());
        assert_eq!(rig.written(), [start.id()]);
        let second = rig.submit(stop.clone());
        assert_eq!(rig.written(), [id]);
        rig.submit(stop.clone());
        assert_eq!(rig.written(), NOTHING, "nothing has started since the second");
        rig.status(id, Status::E_SUCCESS);
        assert_eq!(rig.events(), [SessionEvent::Ended(first, done())]);
        assert_eq!(rig.written(), NOTHING);
        rig.status(id, Status::E_SUCCESS);
        assert_eq!(rig.events(), [SessionEvent::Ended(second, done())]);
        assert_eq!(rig.written(), [id]);
    }
}

#[test]
fn unanswered_stops_are_bounded() {
    let mut rig = Rig::new();
    for _ in 0..20 {
        rig.submit(Command::Stop);
        rig.submit(Command::AcknowledgeFastStop);
        rig.written();
        rig.status(id::ACKNOWLEDGE_FAST_STOP, Status::E_SUCCESS);
    }
    assert_eq!(rig.session.slots.in_flight().count(), 8);
}

#[test]
fn waiting_stop_outlasts_the_stop_before_it() {
    let mut rig = Rig::new();
    rig.submit(Command::Stop);
    rig.written();
    rig.submit(Command::Stop);
    rig.pass(ANSWER);
    assert_eq!(rig.written(), [id::STOP]);
}

#[test]
fn short_request_is_never_too_long() {
    let mut rig = Rig::on_a_line(Some(100));
    rig.flags(SystemState::MOVING);
    rig.submit(grip());
    assert_eq!(rig.written(), [id::GRIP]);
}

#[test]
fn held_request_holds_back_later_ones_of_its_id() {
    let mut rig = Rig::on_a_line(Some(1000));
    rig.submit(grip());
    for bytes in [200, 1] {
        rig.submit(Command::Custom(CustomCommand::new(0xB0, vec![1; bytes]).unwrap()));
    }
    assert_eq!(rig.written(), [id::GRIP]);
    rig.status(id::GRIP, Status::E_CMD_PENDING);
    rig.status(id::GRIP, Status::E_SUCCESS);
    assert_eq!(rig.written(), [0xB0]);
    rig.status(0xB0, Status::E_SUCCESS);
    assert_eq!(rig.written(), [0xB0]);
}

#[test]
fn only_stops_are_written_after_their_deadline() {
    let mut rig = Rig::new();
    for command in [grip(), Command::GetTemperature, Command::Stop, Command::FastStop] {
        rig.submit(command);
    }
    rig.now += 2 * ANSWER;
    assert_eq!(rig.written(), [id::FAST_STOP, id::STOP]);
}

#[test]
fn no_probe_delays_a_fast_stop_on_the_slowest_line() {
    let mut rig = Rig::on_a_line(Some(120));
    rig.flags(SystemState::MOVING);
    rig.pass(LONG_PROBE_AFTER.checked_sub(Duration::from_millis(1)).unwrap());
    assert_eq!(rig.written(), NOTHING);
    rig.flags(SystemState::empty());
    rig.pass(PROBE_AFTER);
    assert_eq!(rig.written(), [id::LOOP]);
}

#[test]
fn lanes_are_bounded() {
    let mut rig = Rig::new();
    for _ in 0..MAX_WAITING_PER_ID {
        rig.submit(Command::GetTemperature);
    }
    assert_eq!(rig.refused(Command::GetTemperature), NotTaken::Full { limit: MAX_WAITING_PER_ID });
    // A flood of one id leaves room for others.
    rig.submit(grip());
    let script = |n: usize| {
        let id = 0xB0 + (n / MAX_WAITING_PER_ID) as u8;
        Command::Custom(CustomCommand::new(id, vec![]).unwrap())
    };
    let left = MAX_WAITING - MAX_WAITING_PER_ID;
    for n in 0..left {
        rig.submit(script(n));
    }
    assert_eq!(rig.refused(script(left)), NotTaken::Full { limit: MAX_WAITING });
    rig.submit(grip());
    rig.submit(Command::FastStop);
}

#[test]
fn stop_does_not_end_later_motion() {
    let mut rig = Rig::new();
    rig.submit(Command::Stop);
    rig.written();
    let motion = rig.submit(grip());
    rig.written();
    rig.status(id::STOP, Status::E_SUCCESS);
    rig.status(id::GRIP, Status::E_CMD_PENDING);
    rig.pass(ABORT_GRACE);
    rig.events();
    rig.pass(RESULT);
    assert_eq!(rig.events(), [SessionEvent::Ended(motion, End::NoResult { stopped: false })]);
}
