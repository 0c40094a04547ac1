//! Ends of servo sessions: whatever ends one leaves no fingers that move on, and disturbs nothing that follows.

use super::*;
use model::{CommandId, LossCause, OnLossMoving, RequestId};
use wsg::CustomCommand;

impl Rig {
    fn standing(&mut self) {
        self.device.flags = SystemState::REFERENCED;
        self.reply(id::GET_SYSTEM_STATE, Status::E_SUCCESS, &self.device.flags.bits().to_le_bytes());
    }

    /// Requests a target, whose frame stays unwritten. Returns its command.
    fn aim_unwritten(&mut self, mm: f32) -> CommandId {
        let (answer, _) = oneshot::channel();
        let request = Steer::Aim(target(mm));
        self.actor.request(self.now, ActorRequest::Steer { request, client: client(), lease: None, answer });
        self.state().command.unwrap()
    }

    fn stop_again(&mut self) -> Result<(), Rejection> {
        let request_id = RequestId::new("stop");
        let submission = Submission { client: client(), action: Action::Stop, request_id, lease: None };
        let id = self.ids.command_id(self.now.wall);
        self.request(|answer| ActorRequest::Submit { submission, id, answer }).try_recv().unwrap().map(drop)
    }

    fn take_lease(&mut self, take: TakeLease) -> LeaseToken {
        let token = LeaseToken::generate();
        let mut granted = self.request(|answer| ActorRequest::TakeLease { take, token: token.clone(), answer });
        granted.try_recv().unwrap().unwrap();
        token
    }
}

/// A gripper that has got a grip, and not answered it, right after the end of a session.
fn gripping_after_a_session() -> Rig {
    let mut rig = steered();
    rig.aim(30.0).unwrap();
    rig.steer(Steer::Stop).unwrap();
    rig.device.held = [id::GRIP].into();
    let width = Width::new(20.0).unwrap();
    let speed = Speed::new(50.0).unwrap();
    let grip = Motion::Grip { width, speed, force: None, part_id: None, recipe: None, is_reference: false };
    rig.submit_by("another", Action::Motion(grip)).unwrap();
    rig.pass_moving(60);
    rig
}

#[test]
fn fingers_that_show_late_that_they_move_are_stopped_at_once() {
    let mut rig = unsteered(ServoAdapter::WidthSpeed);
    rig.standing();
    rig.start(terms()).unwrap();
    rig.aim(30.0).unwrap();
    rig.steer(Steer::Stop).unwrap();
    assert_eq!(rig.count(id::STOP), 1);
}

#[test]
fn fingers_that_stand_still_get_no_stop() {
    let mut rig = unsteered(ServoAdapter::WidthSpeed);
    rig.standing();
    rig.start(ServoTerms { timeout: Duration::from_millis(500), ..terms() }).unwrap();
    rig.aim(30.0).unwrap();
    for _ in 0..60 {
        rig.pass(10);
        rig.standing();
    }
    assert_eq!((rig.servo().ended, rig.count(id::STOP)), (Some(ServoEnd::Silence), 0));
}

#[test]
fn cancelled_target_stops_the_fingers_that_an_earlier_one_moves() {
    let mut rig = steered();
    rig.aim(30.0).unwrap();
    let id = rig.aim_unwritten(40.0);
    let (answer, _) = oneshot::channel();
    rig.actor.request(rig.now, ActorRequest::Cancel { id, client: client(), answer });
    rig.exchange();
    assert_eq!((rig.script_got().len(), rig.count(id::STOP)), (1, 1));
    assert_eq!(ended(&rig.aim(50.0)), Some(ServoEnd::Stop));
}

#[test]
fn repeated_stop_ends_a_session_that_holds_a_part() {
    let mut rig = unsteered(ServoAdapter::WidthSpeed);
    rig.standing();
    rig.stop_again().unwrap();
    rig.start(terms()).unwrap();
    rig.reply(id::GET_GRIPPER_STATE, Status::E_SUCCESS, &[4]);
    rig.stop_again().unwrap();
    assert_eq!(ended(&rig.aim(30.0)), Some(ServoEnd::Stop));
}

#[test]
fn end_of_a_session_does_not_stop_the_next_motion() {
    let mut rig = gripping_after_a_session();
    rig.reply(id::GRIP, Status::E_CMD_PENDING, &[]);
    rig.pass_moving(500);
    rig.reply(id::GRIP, Status::E_SUCCESS, &[]);
    rig.pass(10);
    assert_eq!((rig.count(id::GRIP), rig.count(id::STOP)), (1, 1), "a second Stop would let the part go");
}

#[test]
fn fingers_that_move_on_are_stopped_although_a_motion_was_refused() {
    let mut rig = gripping_after_a_session();
    assert_eq!((rig.count(id::GRIP), rig.count(id::STOP)), (1, 1));
    rig.reply(id::GRIP, Status::E_ALREADY_RUNNING, &[]);
    rig.pass_moving(100);
    assert_eq!(rig.count(id::STOP), 2);
}

#[test]
fn end_of_a_session_does_not_stop_the_next_script() {
    let mut rig = steered();
    rig.aim(30.0).unwrap();
    rig.steer(Steer::Stop).unwrap();
    // It answers at once that it has ended, and its fingers move.
    rig.submit_by("another", Action::Motion(Motion::Custom(CustomCommand::new(0xB7, Vec::new()).unwrap()))).unwrap();
    rig.pass_moving(400);
    assert_eq!((rig.count(0xB7), rig.count(id::STOP)), (1, 1));
}

#[test]
fn part_that_is_held_while_its_target_is_repeated_is_kept() {
    let mut rig = unsteered(ServoAdapter::PositionPd);
    rig.standing();
    rig.start(ServoTerms { force: Some(Force::new(20.0).unwrap()), ..terms() }).unwrap();
    rig.aim(1.0).unwrap();
    // A slow line carries the state seldom.
    for step in 0..60 {
        rig.pass(10);
        rig.standing();
        if step % 13 == 0 {
            rig.reply(id::GET_GRIPPER_STATE, Status::E_SUCCESS, &[4]);
        }
    }
    assert!(rig.script_got().len() > 3);
    assert_eq!((rig.servo().ended, rig.count(id::STOP)), (Some(ServoEnd::Silence), 0));
}

#[test]
fn fingers_that_do_not_stop_after_a_take_over_get_more_stops() {
    let mut rig = steered();
    rig.aim(30.0).unwrap();
    rig.take_lease(TakeLease { force: true, ..TakeLease::by(Client::new("another", Door::Http)) });
    assert_eq!(ended(&rig.aim(40.0)), Some(ServoEnd::Lease));
    rig.pass_moving(1000);
    assert_eq!(rig.count(id::STOP), 3);
}

#[test]
fn stop_of_a_client_is_repeated_if_the_fingers_move_on() {
    let mut rig = steered();
    rig.aim(30.0).unwrap();
    rig.submit_by("another", Action::Stop).unwrap();
    rig.pass_moving(90);
    assert_eq!(rig.count(id::STOP), 1);
    rig.pass_moving(10);
    assert_eq!(rig.count(id::STOP), 2);
}

#[test]
fn lost_holder_steers_no_further_whatever_its_lease_says() {
    for on_loss_moving in [OnLossMoving::Finish, OnLossMoving::Stop] {
        let mut rig = unsteered(ServoAdapter::WidthSpeed);
        let token = rig.take_lease(TakeLease { on_loss_moving: Some(on_loss_moving), ..TakeLease::by(client()) });
        for request in [Steer::Start(terms()), Steer::Aim(target(30.0))] {
            let lease = Some(token.clone());
            let mut answered = rig.request(|answer| ActorRequest::Steer { request, client: client(), lease, answer });
            answered.try_recv().unwrap().unwrap();
        }
        let cause = LossCause::Disconnected;
        rig.actor.request(rig.now, ActorRequest::LoseLease { token, times_taken: None, cause });
        rig.exchange();
        rig.pass_moving(50);
        assert_eq!(rig.count(id::STOP), 1, "{on_loss_moving:?}");
        assert_eq!(rig.servo().ended, Some(ServoEnd::Lease));
    }
}

#[test]
fn force_limit_of_a_session_is_read_back() {
    let mut rig = unsteered(ServoAdapter::WidthSpeed);
    rig.start(ServoTerms { force: Some(Force::new(20.0).unwrap()), ..terms() }).unwrap();
    assert_eq!((rig.count(id::SET_FORCE_LIMIT), rig.count(id::GET_FORCE_LIMIT)), (1, 1));
}

#[test]
fn paced_series_measures_no_rate() {
    let mut rig = steered();
    let widths = [10.0, 20.0].map(|mm| Width::new(mm).unwrap());
    let aim = ServoAim::Widths(widths.into(), Duration::from_millis(200));
    rig.steer(Steer::Aim(ServoTarget { aim, speed: None, at: None })).unwrap();
    rig.pass_moving(100);
    assert!(rig.script_got().len() > 5);
    assert_eq!(rig.servo().rate_hz, None, "the gateway sets the pace, and the device does not");
}
