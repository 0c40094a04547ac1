//! Replies whose data can look like frames.

use super::*;

/// Bytes of a reply to Loop that contains the success of a motion, and whose checksum is wrong.
fn damaged_echo_with_a_result() -> Vec<u8> {
    let mut result = Vec::new();
    Reply::Success(Data::None).encode(id::GRIP, &mut result);
    let mut damaged = Vec::new();
    Reply::Success(Data::Loop(result)).encode(id::LOOP, &mut damaged);
    *damaged.last_mut().unwrap() ^= 1;
    damaged
}

#[test]
fn ruling_echo_of_a_frame_is_no_reply_however_damaged() {
    let damaged = damaged_echo_with_a_result();
    for received in [&damaged[..], &damaged[..damaged.len() - 1]] {
        let mut rig = Rig::new();
        let gripping = rig.submit(grip());
        rig.submit(Command::Loop(LoopData::new(damaged[8..damaged.len() - 2].to_vec()).unwrap()));
        rig.written();
        rig.status(id::GRIP, Status::E_CMD_PENDING);
        assert_eq!(rig.events(), [SessionEvent::Accepted(gripping)]);
        rig.session.receive(rig.now, received);
        rig.pass(Duration::from_millis(50));
        assert_eq!(rig.events(), NO_EVENTS, "the grip has not ended");
        rig.status(id::GRIP, Status::E_SUCCESS);
        assert_eq!(rig.events(), [SessionEvent::Ended(gripping, done())]);
    }
}

#[test]
fn false_header_hides_no_reply() {
    let mut rig = Rig::new();
    let gripping = rig.submit(grip());
    rig.written();
    rig.status(id::GRIP, Status::E_CMD_PENDING);
    rig.events();
    rig.session.receive(rig.now, &[0xAA, 0xAA, 0xAA, id::LOOP, 32, 0]);
    rig.status(id::GRIP, Status::E_SUCCESS);
    assert_eq!(rig.events(), NO_EVENTS);
    rig.pass(Duration::from_millis(50));
    assert_eq!(rig.events(), [SessionEvent::Ended(gripping, done())], "no Loop was sent, so this is no echo");
}

#[test]
fn reply_that_is_too_long_ends_its_request() {
    let mut rig = Rig::new();
    let token = rig.submit(Command::Custom(CustomCommand::new(0xB0, vec![1]).unwrap()));
    rig.written();
    rig.reply(0xB0, &Reply::Success(Data::Custom(vec![0; 5000])));
    assert!(matches!(rig.events()[..], [SessionEvent::Ended(ended, End::Invalid(_))] if ended == token));
}
