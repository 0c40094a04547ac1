//! FAST STOPs and faults of the device.

use super::*;
use crate::latch;
use model::error::Conflict;
use model::{Fault, LeaseToken, TakeLease};

fn acknowledge_fault(rig: &mut Rig, client: Client) -> oneshot::Receiver<Result<(), Rejection>> {
    rig.request(|answer| ActorRequest::AcknowledgeFault { client, lease: None, answer })
}

fn with_error() -> Rig {
    let mut rig = Rig::connected(config(TCP));
    rig.device.gripper_state = 7;
    rig.reply(id::GET_GRIPPER_STATE, Status::E_SUCCESS, &[7]);
    assert_eq!(rig.state().fault_code, Fault::DeviceError.code());
    rig
}

#[test]
fn error_before_its_flags_clears_no_fast_stop() {
    let mut rig = with_error();
    rig.device.flags |= SystemState::FAST_STOP;
    let mut answered = acknowledge_fault(&mut rig, client());
    let latch = rig.state().latch.expect("the FAST STOP is latched");
    let refused = answered.try_recv().unwrap().unwrap_err();
    assert_eq!(refused, Conflict::FastStop { id: latch.fast_stop_id }.into());
    assert_eq!(rig.count(id::ACKNOWLEDGE_FAST_STOP), 0);
}

#[test]
fn error_without_a_fast_stop_is_acknowledged() {
    let mut rig = with_error();
    let mut answered = acknowledge_fault(&mut rig, client());
    assert_eq!(answered.try_recv().unwrap(), Ok(()));
    assert_eq!(rig.count(id::ACKNOWLEDGE_FAST_STOP), 1);
    assert!(!rig.state().fault);
}

#[test]
fn fault_under_a_foreign_lease_is_not_acknowledged() {
    let mut rig = with_error();
    let (take, token) = (TakeLease::by(client()), LeaseToken::generate());
    drop(rig.request(|answer| ActorRequest::TakeLease { take, token, answer }));
    let driver = Client::new("wsg:10.0.0.1", Door::Wsg);
    let refused = acknowledge_fault(&mut rig, driver).try_recv().unwrap().unwrap_err();
    assert!(matches!(refused, Rejection::Conflict(Conflict::LeaseHeld { .. })), "{refused:?}");
    assert_eq!(rig.count(id::ACKNOWLEDGE_FAST_STOP), 0);
}

fn on_change() -> Rig {
    let updates = UpdateRules { mode: UpdateMode::Changes, ..UpdateRules::default() };
    Rig::connected(ActorConfig { rules: GripperRules { updates, ..GripperRules::default() }, ..config(TCP) })
}

#[test]
fn repeated_fast_stop_is_confirmed_at_once_without_updates() {
    let mut rig = on_change();
    for _ in 0..2 {
        let id = rig.fast_stop();
        let latch = rig.state().latch.unwrap();
        assert!(latch.fast_stop_id == id && latch.fast_stop_confirmed, "{latch:?}");
    }
}

#[test]
fn accepted_fast_stop_without_its_flag_is_repeated_in_time() {
    let mut rig = on_change();
    rig.device.held.insert(id::FAST_STOP);
    rig.fast_stop();
    let due = rig.now.instant + latch::REPEAT_EVERY;
    rig.reply(id::FAST_STOP, Status::E_SUCCESS, &[]);
    rig.exchange();
    while rig.now.instant < due {
        assert_eq!(rig.count(id::FAST_STOP), 1);
        rig.now.instant = rig.actor.poll_timeout().expect("a FAST STOP is not confirmed");
        rig.pass(0);
    }
    assert_eq!((rig.now.instant, rig.count(id::FAST_STOP)), (due, 2));
}

#[test]
fn persistent_fast_stop_is_noticed_without_updates() {
    let mut rig = on_change();
    let id = rig.fast_stop();
    rig.device.stays_stopped = true;
    let mut answered = rig.request(|answer| ActorRequest::Acknowledge { id, client: client(), answer });
    rig.pass(500);
    let refused = answered.try_recv().unwrap().unwrap_err();
    assert!(matches!(refused, Rejection::Conflict(Conflict::FastStopPersists { .. })), "{refused:?}");
}
