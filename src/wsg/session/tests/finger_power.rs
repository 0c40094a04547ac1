//! Switching a finger off while it powers up.

use super::*;

fn power(on: bool) -> Command {
    Command::FingerPower { finger: crate::Finger::Two, on }
}

#[test]
fn power_off_does_not_wait_for_the_power_up() {
    for mut rig in [Rig::new(), Rig::on_datagrams()] {
        let on = rig.submit(power(true));
        let off = rig.submit(power(false));
        assert_eq!(rig.written(), [id::FINGER_2_POWER], "until the gripper has accepted it");
        rig.status(id::FINGER_2_POWER, Status::E_CMD_PENDING);
        assert_eq!(rig.written(), [id::FINGER_2_POWER]);
        let again = rig.submit(power(true));
        assert_eq!(rig.written(), NOTHING, "one exception only");
        assert_eq!(rig.events(), [SessionEvent::Accepted(on)]);
        rig.status(id::FINGER_2_POWER, Status::E_CMD_ABORTED);
        let aborted = End::Reply(Reply::Status(Status::E_CMD_ABORTED));
        assert_eq!(rig.events(), [SessionEvent::Ended(on, aborted)]);
        rig.status(id::FINGER_2_POWER, Status::E_SUCCESS);
        assert_eq!(rig.events(), [SessionEvent::Ended(off, done())]);
        assert!(rig.session.withdraw(again));
    }
}

#[test]
fn power_up_without_a_result_is_not_answered_by_a_later_off() {
    let mut rig = Rig::new();
    let on = rig.submit(power(true));
    rig.written();
    rig.status(id::FINGER_2_POWER, Status::E_CMD_PENDING);
    let off = rig.submit(power(false));
    rig.written();
    rig.events();
    rig.pass(ANSWER);
    let events = rig.events();
    assert!(matches!(events[..], [SessionEvent::Ended(ended, End::Unanswered { written: true, .. })] if ended == off));
    rig.status(id::FINGER_2_POWER, Status::E_SUCCESS);
    assert_eq!(rig.events(), [SessionEvent::Ended(on, done())]);
}
