//! Streams of targets for a script: silence stops, and a Stop holds.

use super::*;
use model::error::{Failure, Invalid};
use model::{Action, CustomIds, LeaseToken, Motion, ServoAdapter, ServoRules, Submission, TakeLease};
use wsg::{CustomCommand, Speed, Width};

const SCRIPT: u8 = 0xB1;

const HOLDING: u8 = 4;

/// A gripper with a script, and the token of the client that steers it.
fn steered() -> (Rig, LeaseToken) {
    steered_with(500)
}

fn steered_with(stream_timeout_ms: u64) -> (Rig, LeaseToken) {
    let stream_timeout = Duration::from_millis(stream_timeout_ms);
    let custom_ids = CustomIds { stream: [SCRIPT].into(), stream_timeout, ..CustomIds::default() };
    let mut rig =
        Rig::connected(ActorConfig { rules: GripperRules { custom_ids, ..Default::default() }, ..config(TCP) });
    rig.flags(SystemState::MOVING);
    (rig, LeaseToken::generate())
}

impl Rig {
    /// Sends the flags of a referenced device, with these further ones.
    fn flags(&mut self, more: SystemState) {
        let flags = SystemState::REFERENCED | more;
        self.device.flags = flags;
        self.reply(id::GET_SYSTEM_STATE, Status::E_SUCCESS, &flags.bits().to_le_bytes());
    }

    fn submit(&mut self, action: Action, token: &LeaseToken) -> Result<(), Rejection> {
        let id = self.ids.command_id(self.now.wall);
        let client = Client::new("driver", Door::Wsg);
        let submission = Submission { client, action, request_id: None, lease: Some(token.clone()) };
        let mut answered = self.request(|answer| ActorRequest::Submit { submission, id, answer });
        answered.try_recv().unwrap().map(drop)
    }

    fn target(&mut self, token: &LeaseToken) -> Result<(), Rejection> {
        let target = CustomCommand::new(SCRIPT, vec![0; 8]).unwrap();
        self.submit(Action::Motion(Motion::Custom(target)), token)
    }

    /// Lets time pass while the device goes on sending its flags.
    fn pass_with_flags(&mut self, milliseconds: u64, more: SystemState) {
        for _ in 0..milliseconds / 10 {
            self.now.instant += Duration::from_millis(10);
            self.flags(more);
            self.actor.handle_timeout(self.now);
            self.exchange();
        }
    }
}

fn is_held_off(refused: &Result<(), Rejection>) -> bool {
    matches!(refused, Err(Rejection::Failure(Failure::StoppedFirst { .. })))
}

#[test]
fn silent_stream_is_stopped_once() {
    let (mut rig, token) = steered();
    for _ in 0..20 {
        rig.target(&token).unwrap();
        rig.pass_with_flags(130, SystemState::MOVING);
    }
    assert_eq!(rig.count(id::STOP), 0, "a stream with jitter is healthy");
    rig.pass_with_flags(360, SystemState::MOVING);
    assert_eq!(rig.count(id::STOP), 0);
    rig.pass_with_flags(20, SystemState::MOVING);
    assert_eq!(rig.count(id::STOP), 1);
    rig.pass_with_flags(2000, SystemState::empty());
    assert_eq!(rig.count(id::STOP), 1);
}

#[test]
fn fingers_that_do_not_stop_get_more_stops() {
    let (mut rig, token) = steered();
    rig.target(&token).unwrap();
    rig.pass_with_flags(5000, SystemState::MOVING);
    assert_eq!(rig.count(id::STOP), 3);
}

#[test]
fn target_that_a_script_carries_out_after_a_stop_gets_another_stop() {
    let (mut rig, token) = steered();
    rig.device.held = [SCRIPT].into();
    rig.target(&token).unwrap();
    rig.submit(Action::Stop, &LeaseToken::generate()).unwrap();
    assert_eq!(rig.count(id::STOP), 1);
    rig.pass_with_flags(20, SystemState::empty());
    rig.reply(SCRIPT, Status::E_SUCCESS, &[]);
    rig.pass_with_flags(80, SystemState::MOVING);
    assert_eq!(rig.count(id::STOP), 2, "the script has kept the target");
    rig.pass_with_flags(1000, SystemState::empty());
    assert_eq!(rig.count(id::STOP), 2);
}

#[test]
fn motion_that_shows_late_is_stopped() {
    let (mut rig, token) = steered();
    rig.target(&token).unwrap();
    rig.pass_with_flags(600, SystemState::empty());
    rig.pass_with_flags(50, SystemState::MOVING);
    assert_eq!(rig.count(id::STOP), 1);
}

#[test]
fn fast_stop_holds_a_stream_off_beyond_its_acknowledgement() {
    let (mut rig, token) = steered();
    rig.target(&token).unwrap();
    let id = rig.fast_stop();
    for _ in 0..60 {
        rig.pass_with_flags(30, SystemState::FAST_STOP);
        assert!(matches!(rig.target(&token), Err(Rejection::Conflict(_))));
    }
    rig.device.stays_stopped = false;
    let mut acknowledged = rig.request(|answer| ActorRequest::Acknowledge { id, client: client(), answer });
    rig.pass_with_flags(30, SystemState::empty());
    acknowledged.try_recv().unwrap().unwrap();
    assert!(is_held_off(&rig.target(&token)), "nothing moves because of the acknowledgement");
}

#[test]
fn motion_of_another_client_ends_no_hold() {
    let (mut rig, token) = steered();
    rig.target(&token).unwrap();
    rig.flags(SystemState::empty());
    rig.submit(Action::Stop, &LeaseToken::generate()).unwrap();
    let take = TakeLease { force: true, ..TakeLease::by(client()) };
    let other = LeaseToken::generate();
    let mut leased = rig.request(|answer| ActorRequest::TakeLease { take, token: other.clone(), answer });
    leased.try_recv().unwrap().unwrap();
    assert!(rig.target(&token).is_err());
    rig.pass_with_flags(100, SystemState::empty());
    let width = Width::new(50.0).unwrap();
    let speed = Speed::new(50.0).unwrap();
    rig.submit(Action::Motion(Motion::Release { width, speed }), &other).unwrap();
    assert!(rig.target(&token).is_err());
    for _ in 0..40 {
        rig.pass_with_flags(30, SystemState::empty());
        assert!(rig.target(&token).is_err());
    }
    let (answer, _) = oneshot::channel();
    rig.actor.request(rig.now, ActorRequest::ReleaseLease { token: Some(other), answer });
    rig.exchange();
    let refused = rig.target(&token);
    assert!(is_held_off(&refused), "the stream has never paused: {refused:?}");
}

#[test]
fn silence_of_fingers_that_stand_or_hold_needs_no_stop() {
    let (mut rig, token) = steered();
    rig.target(&token).unwrap();
    rig.pass_with_flags(1000, SystemState::empty());
    assert_eq!(rig.count(id::STOP), 0, "the fingers stand still");
    rig.device.gripper_state = HOLDING;
    rig.reply(id::GET_GRIPPER_STATE, Status::E_SUCCESS, &[HOLDING]);
    rig.target(&token).unwrap();
    rig.pass_with_flags(1000, SystemState::empty());
    assert_eq!(rig.count(id::STOP), 0, "a Stop could let the part go");
}

#[test]
fn stop_holds_a_stream_off_until_it_pauses() {
    let (mut rig, token) = steered();
    rig.target(&token).unwrap();
    rig.submit(Action::Stop, &LeaseToken::generate()).unwrap();
    for _ in 0..100 {
        rig.pass_with_flags(10, SystemState::empty());
        assert!(is_held_off(&rig.target(&token)));
    }
    assert_eq!(rig.count(SCRIPT), 1, "no target follows the Stop");
    rig.pass_with_flags(490, SystemState::empty());
    assert!(is_held_off(&rig.target(&token)), "the pause begins anew");
    rig.pass_with_flags(500, SystemState::empty());
    rig.target(&token).unwrap();
    assert_eq!(rig.count(SCRIPT), 2);
}

#[test]
fn stream_that_was_stopped_may_begin_anew_with_a_motion() {
    let (mut rig, token) = steered();
    rig.target(&token).unwrap();
    rig.flags(SystemState::empty());
    rig.submit(Action::Stop, &token).unwrap();
    assert!(is_held_off(&rig.target(&token)));
    rig.pass_with_flags(100, SystemState::empty());
    let width = Width::new(50.0).unwrap();
    let speed = Speed::new(50.0).unwrap();
    rig.submit(Action::Motion(Motion::Release { width, speed }), &token).unwrap();
    rig.pass_with_flags(1000, SystemState::empty());
    rig.target(&token).unwrap();
}

#[test]
fn silence_can_be_left_to_the_script() {
    let (mut rig, token) = steered_with(0);
    rig.target(&token).unwrap();
    rig.pass_with_flags(5000, SystemState::MOVING);
    assert_eq!(rig.count(id::STOP), 0);
}

#[test]
fn stop_of_fingers_without_a_stream_holds_nothing_off() {
    let (mut rig, token) = steered();
    rig.submit(Action::Stop, &token).unwrap();
    rig.target(&token).unwrap();
    rig.pass_with_flags(1100, SystemState::empty());
    rig.submit(Action::Stop, &token).unwrap();
    rig.target(&token).unwrap();
}

/// A stream whose targets are limited. The measured width is 0.
fn limited() -> (Rig, LeaseToken) {
    let custom_ids = CustomIds { stream: [SCRIPT].into(), ..CustomIds::default() };
    let servo = ServoRules {
        adapter: ServoAdapter::WidthSpeed,
        stream_max_step_mm: 10,
        stream_max_speed_mm_s: 100,
        ..ServoRules::default()
    };
    let rules = GripperRules { custom_ids, servo, ..Default::default() };
    let mut rig = Rig::connected(ActorConfig { rules, ..config(TCP) });
    rig.flags(SystemState::MOVING);
    (rig, LeaseToken::generate())
}

impl Rig {
    fn aim_stream(&mut self, token: &LeaseToken, width_mm: f32, speed_mm_s: f32) -> Result<(), Rejection> {
        let payload = [&[0][..], &width_mm.to_le_bytes(), &speed_mm_s.to_le_bytes()].concat();
        let target = CustomCommand::new(SCRIPT, payload).unwrap();
        self.submit(Action::Motion(Motion::Custom(target)), token)
    }
}

fn is_beyond(result: &Result<(), Rejection>, setting: &str) -> bool {
    matches!(result, Err(Rejection::Invalid(Invalid::OutOfRange { limit, .. })) if *limit == setting)
}

#[test]
fn jump_of_a_stream_is_refused() {
    let (mut rig, token) = limited();
    assert!(
        is_beyond(&rig.aim_stream(&token, 10.5, 50.0), "stream_max_step_mm"),
        "the first target, from the measured width"
    );
    for width_mm in [5.0, 14.0, 20.0] {
        rig.aim_stream(&token, width_mm, 50.0).unwrap();
        rig.pass_with_flags(20, SystemState::MOVING);
    }
    for width_mm in [30.5, 9.5, f32::NAN] {
        assert!(is_beyond(&rig.aim_stream(&token, width_mm, 50.0), "stream_max_step_mm"), "{width_mm} mm");
    }
    rig.aim_stream(&token, 30.0, 50.0).unwrap();
    assert_eq!(rig.count(SCRIPT), 4, "nothing of a refused target reaches the device");
    rig.pass_with_flags(1200, SystemState::empty());
    rig.updates([id::GET_WIDTH]);
    assert!(
        is_beyond(&rig.aim_stream(&token, 31.0, 50.0), "stream_max_step_mm"),
        "after a gap, from the measured width"
    );
    rig.aim_stream(&token, 9.0, 50.0).unwrap();
}

#[test]
fn fast_target_of_a_stream_is_refused() {
    let (mut rig, token) = limited();
    rig.aim_stream(&token, 5.0, 100.0).unwrap();
    for speed_mm_s in [100.5, -1.0, f32::INFINITY] {
        let refused = rig.aim_stream(&token, 5.0, speed_mm_s);
        assert!(is_beyond(&refused, "stream_max_speed_mm_s"), "{speed_mm_s} mm/s");
    }
    let cut = rig.target(&token).unwrap_err().to_string();
    assert!(cut.contains("no width and speed"), "{cut}");
    assert_eq!(rig.count(SCRIPT), 1);
}
