//! Late and duplicate replies, and the Loops that separate them from new ones.

use super::*;
use crate::CustomCommand;

#[test]
fn late_reply_does_not_end_next_request_of_its_id() {
    let mut rig = Rig::new();
    let first = rig.submit(Command::GetForceLimit);
    rig.written();
    rig.pass(ANSWER);
    let waited = ANSWER;
    assert_eq!(rig.events(), [SessionEvent::Ended(first, End::Unanswered { written: true, stopped: false, waited })]);
    let second = rig.submit(Command::GetForceLimit);
    let echo = rig.echo_of_written_loop();
    assert_eq!(rig.written(), NOTHING, "the id is closed");

    let old = Reply::Success(Data::ForceLimit(Force::new(10.0).unwrap()));
    rig.reply(id::GET_FORCE_LIMIT, &old);
    assert_eq!(rig.events(), NO_EVENTS);
    assert_eq!(rig.session.counters().late_replies, 1);

    rig.session.receive(rig.now, &echo);
    assert_eq!(rig.written(), [id::GET_FORCE_LIMIT]);
    let new = Reply::Success(Data::ForceLimit(Force::new(40.0).unwrap()));
    rig.reply(id::GET_FORCE_LIMIT, &new);
    assert_eq!(rig.events(), [SessionEvent::Ended(second, End::Reply(new))]);
}

#[test]
fn echo_of_loop_before_timeout_opens_nothing() {
    let mut rig = Rig::new();
    rig.submit(Command::GetForceLimit);
    rig.submit(Command::GetTemperature);
    rig.written();
    rig.pass(ANSWER / 2);
    rig.submit(Command::GetAcceleration);
    rig.written();
    rig.pass(ANSWER / 2);
    let old_echo = rig.echo_of_written_loop();
    rig.pass(ANSWER / 2);
    rig.submit(Command::GetAcceleration);
    rig.session.receive(rig.now, &old_echo);
    let new_echo = rig.echo_of_written_loop();
    assert_eq!(rig.written(), NOTHING, "31h timed out after that Loop was sent");
    rig.session.receive(rig.now, &new_echo);
    assert_eq!(rig.written(), [id::GET_ACCELERATION]);
}

#[test]
fn two_step_id_stays_closed_until_late_result() {
    let mut rig = Rig::new();
    rig.submit(grip());
    rig.written();
    rig.pass(ANSWER);
    let echo = rig.echo_of_written_loop();
    rig.session.receive(rig.now, &echo);
    let second = rig.submit(grip());
    rig.flags(SystemState::MOVING);
    assert_eq!(rig.written(), NOTHING, "it may still be running");
    rig.status(id::GRIP, Status::E_CMD_PENDING);
    assert_eq!(rig.written(), NOTHING);
    rig.status(id::GRIP, Status::E_SUCCESS);
    rig.events();
    assert_eq!(rig.written(), [id::GRIP]);
    rig.status(id::GRIP, Status::E_CMD_PENDING);
    assert_eq!(rig.events(), [SessionEvent::Accepted(second)]);
}

#[test]
fn two_step_id_opens_when_not_moving_after_echo() {
    let mut rig = Rig::new();
    rig.submit(grip());
    rig.written();
    rig.pass(ANSWER);
    rig.submit(grip());
    rig.flags(SystemState::REFERENCED);
    let echo = rig.echo_of_written_loop();
    assert_eq!(rig.written(), NOTHING, "the update was sent before the echo");
    rig.session.receive(rig.now, &echo);
    assert_eq!(rig.written(), NOTHING);
    rig.flags(SystemState::REFERENCED);
    assert_eq!(rig.written(), [id::GRIP]);
}

fn script(payload: u8) -> Command {
    Command::Custom(CustomCommand::new(0xB3, vec![payload]).unwrap())
}

/// Lets a request time out, and echoes the Loop after it.
fn time_out(rig: &mut Rig, command: Command) {
    rig.submit(command);
    rig.written();
    rig.pass(ANSWER);
    let echo = rig.echo_of_written_loop();
    rig.session.receive(rig.now, &echo);
    rig.events();
}

fn script_reply(payload: u8) -> Reply {
    Reply::Success(Data::Custom(vec![payload]))
}

#[test]
fn late_reply_of_a_script_does_not_end_its_next_request() {
    let mut rig = Rig::new();
    time_out(&mut rig, script(1));
    assert_eq!(rig.refused(script(2)), NotTaken::Unanswered, "the script still runs, although the device echoes");
    rig.reply(0xB3, &script_reply(1));
    assert_eq!(rig.events(), NO_EVENTS);
    assert_eq!(rig.session.counters().late_replies, 1);
    let second = rig.submit(script(2));
    assert_eq!(rig.written(), [0xB3]);
    rig.reply(0xB3, &script_reply(2));
    assert_eq!(rig.events(), [SessionEvent::Ended(second, End::Reply(script_reply(2)))]);
}

#[test]
fn script_without_a_reply_can_be_called_again_after_a_while() {
    let mut rig = Rig::new();
    time_out(&mut rig, script(1));
    // The device stays silent, so the session probes it.
    rig.pass(SCRIPT_REPLIES_WITHIN.saturating_sub(2 * ANSWER));
    let echo = rig.echo_of_written_loop();
    rig.session.receive(rig.now, &echo);
    assert_eq!(rig.session.poll_timeout(), Some(rig.now + ANSWER));
    rig.pass(ANSWER / 2);
    assert_eq!(rig.refused(script(2)), NotTaken::Unanswered);
    rig.pass(ANSWER / 2);
    let second = rig.submit(script(2));
    let echo = rig.echo_of_written_loop();
    assert_eq!(rig.written(), NOTHING, "the late reply can be before the echo");
    rig.session.receive(rig.now, &echo);
    assert_eq!(rig.written(), [0xB3]);
    rig.reply(0xB3, &script_reply(2));
    assert_eq!(rig.events(), [SessionEvent::Ended(second, End::Reply(script_reply(2)))]);
}

#[test]
fn duplicate_of_a_late_reply_does_not_end_the_next_request() {
    let mut rig = Rig::on_datagrams();
    time_out(&mut rig, script(1));
    rig.reply(0xB3, &script_reply(1));
    rig.submit(script(2));
    let echo = rig.echo_of_written_loop();
    rig.reply(0xB3, &script_reply(1));
    assert_eq!((rig.written(), rig.events()), (NOTHING.to_vec(), NO_EVENTS.to_vec()));
    rig.session.receive(rig.now, &echo);
    rig.pass(DUPLICATE_WITHIN);
    assert_eq!(rig.written(), [0xB3]);
}

#[test]
fn slow_echo_still_opens_ids() {
    let mut rig = Rig::new();
    rig.submit(Command::GetForceLimit);
    rig.written();
    rig.pass(ANSWER);
    rig.submit(Command::GetForceLimit);
    let first = rig.echo_of_written_loop();
    rig.pass(Duration::from_millis(50));
    // The session sends another Loop before the echo of the first arrives.
    rig.now += Duration::from_millis(350);
    rig.session.handle_timeout(rig.now);
    let request = Request { command: Command::GetForceLimit, reply_within: ANSWER, result_within: RESULT };
    rig.session.submit(rig.now, request).unwrap();
    assert_eq!(rig.written(), [id::LOOP]);
    rig.session.receive(rig.now, &first);
    assert_eq!(rig.written(), [id::GET_FORCE_LIMIT], "replies sent before the first Loop have arrived");
}

#[test]
fn duplicate_echo_does_not_end_next_loop() {
    let mut rig = Rig::new();
    let (first, second) = (LoopData::new(vec![1]).unwrap(), LoopData::new(vec![2]).unwrap());
    let token = rig.submit(Command::Loop(first));
    let echo = rig.echo_of_written_loop();
    rig.session.receive(rig.now, &echo);
    let answered = |token, byte| SessionEvent::Ended(token, End::Reply(Reply::Success(Data::Loop(vec![byte]))));
    assert_eq!(rig.events(), [answered(token, 1)]);
    let token = rig.submit(Command::Loop(second));
    let other = rig.echo_of_written_loop();
    rig.session.receive(rig.now, &echo);
    assert_eq!(rig.events(), NO_EVENTS);
    rig.session.receive(rig.now, &other);
    assert_eq!(rig.events(), [answered(token, 2)]);
    assert_eq!(rig.session.counters().late_replies, 1);
}

#[test]
fn duplicate_reply_does_not_end_next_request_of_its_id() {
    let mut rig = Rig::on_datagrams();
    let set = |n| Command::SetForceLimit(Force::new(n).unwrap());
    let first = rig.submit(set(10.0));
    rig.written();
    rig.status(id::SET_FORCE_LIMIT, Status::E_SUCCESS);
    assert_eq!(rig.events(), [SessionEvent::Ended(first, End::Reply(Reply::Success(Data::None)))]);
    let second = rig.submit(set(500.0));
    let echo = rig.echo_of_written_loop();
    assert_eq!(rig.written(), NOTHING);
    rig.status(id::SET_FORCE_LIMIT, Status::E_SUCCESS);
    assert_eq!(rig.events(), NO_EVENTS, "duplicate of the first reply");
    rig.session.receive(rig.now, &echo);
    assert_eq!(rig.written(), NOTHING);
    rig.status(id::SET_FORCE_LIMIT, Status::E_SUCCESS);
    assert_eq!(rig.events(), NO_EVENTS, "duplicate that the echo has overtaken");
    assert_eq!(rig.session.poll_timeout(), Some(rig.now + DUPLICATE_WITHIN));
    rig.pass(DUPLICATE_WITHIN);
    assert_eq!(rig.written(), [id::SET_FORCE_LIMIT]);
    rig.status(id::SET_FORCE_LIMIT, Status::E_RANGE_ERROR);
    assert_eq!(rig.events(), [SessionEvent::Ended(second, End::Reply(Reply::Status(Status::E_RANGE_ERROR)))]);
}

#[test]
fn client_loop_and_session_loop_do_not_mix() {
    let mut rig = Rig::new();
    rig.pass(PROBE_AFTER);
    let probe = rig.echo_of_written_loop();
    let data = LoopData::new(vec![1, 2, 3]).unwrap();
    let token = rig.submit(Command::Loop(data.clone()));
    assert_eq!(rig.written(), NOTHING, "one Loop is in flight");
    rig.session.receive(rig.now, &probe);
    assert_eq!(rig.written(), [id::LOOP]);
    rig.session.receive(rig.now, &probe);
    assert_eq!(rig.events(), NO_EVENTS, "a duplicate echo of the session's Loop does not end the client's");
    let reply = Reply::Success(Data::Loop(data.as_bytes().to_vec()));
    rig.reply(id::LOOP, &reply);
    assert_eq!(rig.events(), [SessionEvent::Ended(token, End::Reply(reply))]);
}

#[test]
fn device_that_has_repeated_a_reply_does_not_end_a_later_request_with_another() {
    let mut rig = Rig::new();
    let id = id::SET_FORCE_LIMIT;
    let set = |n| Command::SetForceLimit(Force::new(n).unwrap());
    rig.submit(set(10.0));
    rig.written();
    rig.status(id, Status::E_SUCCESS);
    rig.status(id, Status::E_SUCCESS);
    assert_eq!(rig.session.counters().stray_replies, 1);
    rig.submit(set(20.0));
    assert_eq!(rig.written(), [id]);
    rig.status(id, Status::E_SUCCESS);
    rig.events();
    let last = rig.submit(set(500.0));
    let echo = rig.echo_of_written_loop();
    assert_eq!(rig.written(), NOTHING);
    rig.status(id, Status::E_SUCCESS);
    assert_eq!(rig.events(), NO_EVENTS, "repeated reply");
    rig.session.receive(rig.now, &echo);
    assert_eq!(rig.written(), [id]);
    rig.status(id, Status::E_RANGE_ERROR);
    assert_eq!(rig.events(), [SessionEvent::Ended(last, End::Reply(Reply::Status(Status::E_RANGE_ERROR)))]);
}

#[test]
fn reply_too_many_closes_no_other_id() {
    let mut rig = Rig::new();
    for id in [id::STOP, id::FAST_STOP, id::SET_FORCE_LIMIT] {
        rig.status(id, Status::E_SUCCESS);
    }
    for command in [Command::GetTemperature, Command::Stop, Command::FastStop] {
        let id = command.id();
        rig.submit(command);
        rig.written();
        rig.status(id, Status::E_NOT_AVAILABLE);
        assert_eq!(rig.written(), NOTHING, "no Loop");
    }
}

#[test]
fn result_of_an_accepted_script_is_awaited_beyond_its_time_limit() {
    let mut rig = Rig::new();
    rig.submit(script(1));
    rig.written();
    rig.status(0xB3, Status::E_CMD_PENDING);
    rig.pass(RESULT);
    assert_eq!(rig.refused(script(2)), NotTaken::Unanswered);
    rig.pass(SCRIPT_REPLIES_WITHIN);
    rig.submit(script(2));
}
