//! Servo sessions: the newest target wins, silence stops, and whatever stops the fingers ends the session.

use super::*;
use jiff::SignedDuration;
use model::error::{Conflict, Invalid};
use model::{
    Action, LeaseToken, Motion, ServoAdapter, ServoAim, ServoEnd, ServoReport, ServoRules, ServoTarget, ServoTerms,
    Steer, Submission, TakeLease,
};
use wsg::{Force, Speed, Width};

mod ends;

const SCRIPT: u8 = 0xB1;

/// A gripper that is steered by a script with a width and a speed, and whose fingers move.
fn steered() -> Rig {
    let mut rig = unsteered(ServoAdapter::WidthSpeed);
    rig.start(terms()).unwrap();
    rig
}

fn unsteered(adapter: ServoAdapter) -> Rig {
    let servo = ServoRules { adapter, ..ServoRules::default() };
    let mut rig = Rig::connected(ActorConfig { rules: GripperRules { servo, ..Default::default() }, ..config(TCP) });
    rig.moving();
    rig
}

fn terms() -> ServoTerms {
    let max_speed = Speed::new(100.0).unwrap();
    ServoTerms { adapter: None, timeout: Duration::from_millis(200), max_speed, force: None }
}

fn target(mm: f32) -> ServoTarget {
    ServoTarget { aim: ServoAim::Width(Width::new(mm).unwrap()), speed: None, at: None }
}

impl Rig {
    /// Sends the flags of fingers that move.
    fn moving(&mut self) {
        self.device.flags = SystemState::REFERENCED | SystemState::MOVING;
        self.reply(id::GET_SYSTEM_STATE, Status::E_SUCCESS, &self.device.flags.bits().to_le_bytes());
    }

    fn steer(&mut self, request: Steer) -> Result<ServoReport, Rejection> {
        let steer = |answer| ActorRequest::Steer { request, client: client(), lease: None, answer };
        self.request(steer).try_recv().unwrap()
    }

    fn start(&mut self, terms: ServoTerms) -> Result<ServoReport, Rejection> {
        self.steer(Steer::Start(terms))
    }

    fn aim(&mut self, mm: f32) -> Result<ServoReport, Rejection> {
        self.steer(Steer::Aim(target(mm)))
    }

    /// Sends a target for this time in ms from now.
    fn aim_at(&mut self, ms: i64) -> Result<ServoReport, Rejection> {
        let at = Some(time_in(self, ms));
        self.steer(Steer::Aim(ServoTarget { at, ..target(30.0) }))
    }

    /// Widths and speeds that the script has got.
    fn script_got(&self) -> Vec<(f32, f32)> {
        let requests = self.device.received.iter().filter(|(received, _)| *received == SCRIPT);
        requests.map(|(_, payload)| (float(payload, 1), float(payload, 5))).collect()
    }

    fn servo(&self) -> ServoReport {
        ServoReport::clone(&self.state().servo.unwrap())
    }

    fn submit_by(&mut self, who: &str, action: Action) -> Result<(), Rejection> {
        let id = self.ids.command_id(self.now.wall);
        let submission = Submission { client: Client::new(who, Door::Http), action, request_id: None, lease: None };
        let mut answered = self.request(|answer| ActorRequest::Submit { submission, id, answer });
        answered.try_recv().unwrap().map(drop)
    }

    /// Lets time pass, with flags from the device.
    fn pass_moving(&mut self, milliseconds: u64) {
        for _ in 0..milliseconds / 10 {
            self.pass(10);
            self.moving();
        }
    }
}

/// The time in ms from now.
fn time_in(rig: &Rig, ms: i64) -> jiff::Timestamp {
    rig.now.wall + SignedDuration::from_millis(ms)
}

fn float(payload: &[u8], from: usize) -> f32 {
    f32::from_le_bytes(payload[from..from + 4].try_into().unwrap())
}

fn ended(result: &Result<ServoReport, Rejection>) -> Option<ServoEnd> {
    match result {
        Err(Rejection::Conflict(Conflict::NoServo { ended })) => *ended,
        other => panic!("{other:?}"),
    }
}

#[test]
fn newest_target_overtakes_those_that_wait() {
    let mut rig = steered();
    rig.device.held = [SCRIPT].into();
    for mm in [10.0, 20.0, 30.0, 40.0] {
        rig.aim(mm).unwrap();
    }
    assert_eq!(rig.script_got(), [(10.0, 100.0)], "the device has not answered yet");
    rig.pass(25);
    rig.reply(SCRIPT, Status::E_SUCCESS, &[]);
    rig.exchange();
    assert_eq!(rig.script_got(), [(10.0, 100.0), (40.0, 100.0)]);
    let servo = rig.servo();
    assert_eq!((servo.accepted, servo.superseded, servo.refused), (4, 2, 0));
    assert_eq!((servo.target_mm, servo.applied_mm, servo.applied_age_ms), (Some(40.0), Some(10.0), Some(25.0)));
    assert_eq!(servo.rate_hz, Some(40.0), "a target waited for 25 ms");
}

#[test]
fn silent_session_ends_with_a_stop() {
    let mut rig = steered();
    rig.aim(30.0).unwrap();
    for _ in 0..5 {
        rig.pass_moving(130);
        rig.aim(30.0).unwrap();
    }
    assert_eq!(rig.count(id::STOP), 0, "targets with pauses are healthy");
    rig.pass_moving(190);
    assert_eq!(rig.count(id::STOP), 0);
    rig.pass_moving(10);
    assert_eq!(rig.count(id::STOP), 1);
    assert_eq!(ended(&rig.aim(40.0)), Some(ServoEnd::Silence));
    let servo = rig.servo();
    assert_eq!((servo.open, servo.ended, servo.longest_gap_ms), (false, Some(ServoEnd::Silence), 130));
}

#[test]
fn silence_stops_although_the_device_has_not_answered_a_target() {
    let mut rig = steered();
    rig.device.held = [SCRIPT].into();
    rig.aim(30.0).unwrap();
    rig.pass_moving(200);
    assert_eq!(rig.count(id::STOP), 1);
}

#[test]
fn fingers_that_do_not_stop_get_more_stops() {
    let mut rig = steered();
    rig.aim(30.0).unwrap();
    rig.pass_moving(5000);
    assert_eq!(rig.count(id::STOP), 3);
}

#[test]
fn session_without_targets_ends_without_a_stop() {
    let mut rig = steered();
    rig.pass_moving(1000);
    assert_eq!(rig.count(id::STOP), 0);
    assert_eq!(ended(&rig.aim(40.0)), Some(ServoEnd::Silence));
}

#[test]
fn stop_of_anybody_ends_the_session() {
    let mut rig = steered();
    rig.device.held = [SCRIPT].into();
    rig.aim(30.0).unwrap();
    rig.aim(40.0).unwrap();
    rig.submit_by("another", Action::Stop).unwrap();
    rig.reply(SCRIPT, Status::E_CMD_ABORTED, &[]);
    rig.pass_moving(100);
    assert_eq!(ended(&rig.aim(50.0)), Some(ServoEnd::Stop));
    assert_eq!(rig.script_got().len(), 1, "no target follows the Stop");
}

#[test]
fn fast_stop_ends_the_session() {
    let mut rig = steered();
    rig.aim(30.0).unwrap();
    rig.fast_stop();
    assert_eq!(ended(&rig.aim(40.0)), Some(ServoEnd::FastStop));
    assert!(matches!(rig.start(terms()), Err(Rejection::Conflict(Conflict::FastStop { .. }))));
}

#[test]
fn fingers_that_still_move_on_the_next_link_are_stopped() {
    let mut rig = steered();
    rig.aim(30.0).unwrap();
    rig.actor.link_down(rig.now, "unplugged");
    rig.device.received.clear();
    rig.actor.link_up(rig.now);
    rig.exchange();
    assert_eq!(ended(&rig.aim(40.0)), Some(ServoEnd::Link));
    rig.pass_moving(310);
    assert_eq!((rig.count(id::STOP), rig.count(SCRIPT)), (1, 0));
}

#[test]
fn client_that_takes_the_lease_ends_the_session() {
    let mut rig = steered();
    rig.aim(30.0).unwrap();
    let take = TakeLease::by(Client::new("another", Door::Http));
    let mut taken = rig.request(|answer| ActorRequest::TakeLease { take, token: LeaseToken::generate(), answer });
    taken.try_recv().unwrap().unwrap();
    assert_eq!(rig.count(id::STOP), 1);
    assert_eq!(ended(&rig.aim(40.0)), Some(ServoEnd::Lease));
}

#[test]
fn other_motions_wait_for_the_end_of_the_session() {
    let mut rig = steered();
    let width = Width::new(50.0).unwrap();
    let speed = Speed::new(50.0).unwrap();
    let release = Action::Motion(Motion::Release { width, speed });
    let refused = rig.submit_by("another", release.clone());
    assert!(matches!(refused, Err(Rejection::Conflict(Conflict::Steering { .. }))), "{refused:?}");
    assert!(matches!(rig.start(terms()), Err(Rejection::Conflict(Conflict::Steering { .. }))));
    rig.steer(Steer::Stop).unwrap();
    rig.submit_by("another", release).unwrap();
}

#[test]
fn targets_beyond_the_limits_are_refused_and_counted() {
    let mut rig = steered();
    let refused = rig.aim(111.0);
    assert!(matches!(refused, Err(Rejection::Invalid(Invalid::OutOfRange { field: "width_mm", .. }))), "{refused:?}");
    let fast = ServoTarget { speed: Some(Speed::new(101.0).unwrap()), ..target(30.0) };
    let refused = rig.steer(Steer::Aim(fast));
    assert!(matches!(refused, Err(Rejection::Invalid(Invalid::OutOfRange { field: "speed_mm_s", .. }))), "{refused:?}");
    let widths = [10.0, 20.0].map(|mm| Width::new(mm).unwrap());
    let aim = ServoAim::Widths(widths.into(), Duration::from_millis(50));
    let refused = rig.steer(Steer::Aim(ServoTarget { aim, speed: None, at: None }));
    assert!(matches!(refused, Err(Rejection::Invalid(Invalid::OutOfRange { field: "widths_mm", .. }))), "{refused:?}");
    assert_eq!((rig.servo().refused, rig.count(SCRIPT)), (3, 0));
}

#[test]
fn old_targets_are_refused() {
    let mut rig = steered();
    rig.aim_at(-10).unwrap();
    for stale in [-10, -11, -300, 1100] {
        let refused = rig.aim_at(stale);
        assert!(matches!(refused, Err(Rejection::Conflict(Conflict::StaleTarget { .. }))), "{stale}: {refused:?}");
    }
    rig.aim_at(-9).unwrap();
}

#[test]
fn series_of_widths_is_interpolated_until_its_end() {
    let mut rig = steered();
    let widths = [10.0, 14.0, 12.0].map(|mm| Width::new(mm).unwrap());
    let aim = ServoAim::Widths(widths.into(), Duration::from_millis(40));
    rig.steer(Steer::Aim(ServoTarget { aim, speed: None, at: None })).unwrap();
    rig.pass_moving(100);
    let got: Vec<_> = rig.script_got().iter().map(|(mm, _)| mm.round()).collect();
    assert_eq!(got, [10.0, 11.0, 12.0, 13.0, 14.0, 14.0, 13.0, 13.0, 12.0]);
    rig.pass_moving(170);
    assert_eq!(rig.count(id::STOP), 0, "silence begins at the end of the series");
    rig.pass_moving(10);
    assert_eq!(rig.count(id::STOP), 1);
}

#[test]
fn refusal_of_the_device_ends_the_session() {
    let mut rig = steered();
    rig.device.held = [SCRIPT].into();
    rig.aim(30.0).unwrap();
    rig.reply(SCRIPT, Status::E_CMD_UNKNOWN, &[]);
    rig.exchange();
    assert_eq!(ended(&rig.aim(40.0)), Some(ServoEnd::Device));
}

#[test]
fn moves_end_early_for_a_newer_target() {
    let mut rig = unsteered(ServoAdapter::Moves);
    rig.start(terms()).unwrap();
    rig.device.held = [id::PRE_POSITION].into();
    rig.aim(30.0).unwrap();
    rig.reply(id::PRE_POSITION, Status::E_CMD_PENDING, &[]);
    rig.pass_moving(50);
    rig.aim(40.0).unwrap();
    assert_eq!(rig.count(id::STOP), 0, "a motion has time to move the fingers");
    rig.pass_moving(50);
    assert_eq!(rig.count(id::STOP), 1);
    rig.reply(id::PRE_POSITION, Status::E_CMD_ABORTED, &[]);
    rig.pass_moving(50);
    let widths: Vec<_> = rig.device.received.iter().filter(|(id, _)| *id == id::PRE_POSITION).collect();
    assert_eq!(widths.iter().map(|(_, payload)| float(payload, 1)).collect::<Vec<_>>(), [30.0, 40.0]);
    assert!(rig.servo().open);
}

#[test]
fn script_without_a_limit_of_speed_gets_widths_on_the_way_after_its_force_limit() {
    let mut rig = unsteered(ServoAdapter::PositionPd);
    assert!(rig.start(terms()).is_err(), "the script needs a force");
    rig.device.held = [id::SET_FORCE_LIMIT].into();
    rig.start(ServoTerms { force: Some(Force::new(20.0).unwrap()), ..terms() }).unwrap();
    rig.aim(30.0).unwrap();
    assert_eq!(rig.count(SCRIPT), 0);
    rig.reply(id::SET_FORCE_LIMIT, Status::E_SUCCESS, &[]);
    rig.exchange();
    let payload = rig.device.received.iter().find(|(id, _)| *id == SCRIPT).map(|(_, payload)| payload.clone()).unwrap();
    let floats: Vec<_> = (1..25).step_by(4).map(|from| float(&payload, from)).collect();
    assert_eq!((payload.len(), payload[0]), (25, 0));
    assert_eq!(floats, [1.0, 0.0, 15.0, 0.001, 20.0, 20.0], "1 mm in 10 ms");
    rig.pass_moving(180);
    rig.aim(2.5).unwrap();
    rig.pass_moving(190);
    assert_eq!(rig.script_got().last().map(|(mm, _)| *mm), Some(2.5));
    let steps = rig.script_got();
    assert!(steps.windows(2).all(|pair| (pair[1].0 - pair[0].0).abs() <= 1.001), "{steps:?}");
    // The script would go on with its last speed, past the target.
    rig.aim(2.5).unwrap();
    rig.pass_moving(190);
    let repeated = &rig.script_got()[steps.len()..];
    assert_eq!(repeated.iter().map(|(mm, _)| *mm).collect::<Vec<_>>(), [2.5; 4], "every 50 ms");
}

#[test]
fn script_without_a_limit_of_speed_gets_its_width_until_a_later_series_begins() {
    let mut rig = unsteered(ServoAdapter::PositionPd);
    rig.start(ServoTerms { force: Some(Force::new(20.0).unwrap()), ..terms() }).unwrap();
    rig.aim(30.0).unwrap();
    rig.pass_moving(100);
    let before = rig.script_got();
    let aim = ServoAim::Widths([20.0, 21.0].map(|mm| Width::new(mm).unwrap()).into(), Duration::from_millis(100));
    let at = Some(time_in(&rig, 500));
    rig.steer(Steer::Aim(ServoTarget { aim, speed: None, at })).unwrap();
    rig.pass_moving(400);
    let repeated: Vec<_> = rig.script_got()[before.len()..].iter().map(|(mm, _)| *mm).collect();
    assert!(
        repeated.len() >= 7 && repeated.iter().all(|mm| Some(mm) == before.last().map(|(mm, _)| mm)),
        "{repeated:?}"
    );
    rig.pass_moving(400);
    assert_eq!(rig.script_got().last().map(|(mm, _)| *mm), Some(21.0));
}

#[test]
fn targets_of_another_client_are_refused() {
    let mut rig = steered();
    let request = Steer::Aim(target(30.0));
    let other = Client::new("another", Door::Http);
    let mut answered = rig.request(|answer| ActorRequest::Steer { request, client: other, lease: None, answer });
    assert!(matches!(answered.try_recv().unwrap(), Err(Rejection::Conflict(Conflict::NoServo { ended: None }))));
}
