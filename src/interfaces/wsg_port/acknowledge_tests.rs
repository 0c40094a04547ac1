//! Tests of 24h, and of the causes of refusals.

use super::super::super::status::RefusedStatus;
use super::*;

fn acknowledges(bench: &mut Bench) -> bool {
    bench.send(id::ACKNOWLEDGE_FAST_STOP, b"ack");
    match bench.device.poll_order() {
        Some(PortOrdered { order: PortOrder::Acknowledge(_), ask }) => {
            bench.answer(ask, NOTHING);
            assert_eq!(bench.sent().last(), Some(&(id::ACKNOWLEDGE_FAST_STOP, Status::E_SUCCESS)));
            true
        }
        None => {
            assert_eq!(bench.sent().last(), Some(&(id::ACKNOWLEDGE_FAST_STOP, Status::E_ACCESS_DENIED)));
            assert_eq!(bench.device.poll_refused().unwrap().status, Status::E_ACCESS_DENIED);
            false
        }
        order => panic!("{order:?}"),
    }
}

#[test]
fn blind_acknowledge_clears_faults_and_own_loss() {
    let id = FastStopId::generate();
    let (mine, other) = ("wsg:10.0.0.1", "wsg:10.0.0.2");
    for (cause, by, when_free, when_held) in [
        (FastStopCause::Requested, mine, false, false),
        (FastStopCause::ClientLost, mine, true, false),
        (FastStopCause::ClientLost, other, false, false),
        (FastStopCause::UnannouncedDisconnect, "device", true, false),
        (FastStopCause::CurrentFault, "device", true, false),
        (FastStopCause::SoftLimit, "device", true, false),
        (FastStopCause::Unknown, "device", false, false),
    ] {
        let mut state = latched(id, cause);
        state.latch.as_mut().unwrap().fast_stop_by = by.into();
        let mut bench = Bench { state: state.clone(), ..Bench::new() };
        assert_eq!(acknowledges(&mut bench), when_free, "{cause:?} by {by}");
        state.lease_holder = Some("somebody".into());
        let mut bench = Bench { state: state.clone(), ..Bench::new() };
        assert_eq!(acknowledges(&mut bench), when_held, "{cause:?} by {by}, lease held");
        let mut holder = Bench { state, ..Bench::new() };
        holder.device.set_holder(true);
        assert_eq!(acknowledges(&mut holder), when_free, "{cause:?} by {by}, own lease");
    }
}

#[test]
fn seen_latch_of_the_device_can_be_acknowledged() {
    let id = FastStopId::generate();
    let refusal = PortReply::Refused(RefusedStatus { status: Status::E_ACCESS_DENIED, fast_stop: Some(id) });
    for (cause, by_device) in [
        (FastStopCause::Requested, false),
        (FastStopCause::ClientLost, false),
        (FastStopCause::UnannouncedDisconnect, true),
        (FastStopCause::CurrentFault, true),
        (FastStopCause::Unknown, true),
    ] {
        let held = State { lease_holder: Some("somebody".into()), ..latched(id, cause) };
        let bench = || Bench { state: held.clone(), ..Bench::new() };
        let mut asked = bench();
        asked.send(id::GET_SYSTEM_STATE, &[0; 3]);
        assert_eq!(acknowledges(&mut asked), by_device, "seen in 40h: {cause:?}");

        let mut updated = bench();
        updated.send(id::GET_GRIPPER_STATE, &[1, 10, 0]);
        updated.take_state(GripperState::Error);
        updated.pass(Duration::from_millis(10));
        assert_eq!(acknowledges(&mut updated), by_device, "seen as ERROR in an update of 41h: {cause:?}");

        let mut refused = bench();
        refused.send(id::HOMING, &[0]);
        let ask = refused.order().ask;
        refused.answer(ask, refusal.clone());
        assert_eq!(acknowledges(&mut refused), by_device, "seen in a refused motion: {cause:?}");

        let mut malformed = bench();
        malformed.send(id::HOMING, &[]);
        assert_eq!(malformed.sent(), [(id::HOMING, Status::E_ACCESS_DENIED)]);
        assert_eq!(acknowledges(&mut malformed), by_device, "seen in a malformed motion: {cause:?}");

        let mut any = Bench::with(&Rules { acknowledge: AcknowledgePolicy::Any, ..rules() });
        any.state = held.clone();
        assert!(acknowledges(&mut any), "acknowledge_any: {cause:?}");
    }
    let mut own = Bench { state: latched(id, FastStopCause::Requested), ..Bench::new() };
    own.send(id::FAST_STOP, &[]);
    let ask = own.order().ask;
    own.answer(ask, PortReply::FastStopped(FastStop { id, confirmed: true }));
    assert!(!acknowledges(&mut own), "somebody's earlier FAST STOP lasts on");
    if let Some(latch) = &mut own.state.latch {
        latch.fast_stop_by = "wsg:10.0.0.1".into();
    }
    assert!(acknowledges(&mut own), "its own");
    // A later FAST STOP of another client is a different one.
    own.state = latched(FastStopId::generate(), FastStopCause::Requested);
    assert!(!acknowledges(&mut own));
}

#[test]
fn fault_without_a_latch_is_passed_on() {
    for (fault_code, is_passed_on) in [(0, false), (3, false), (21, true), (30, true)] {
        let mut bench = Bench { state: State { fault_code, ..state() }, ..Bench::new() };
        bench.send(id::ACKNOWLEDGE_FAST_STOP, b"ack");
        let order = bench.device.poll_order();
        assert_eq!(order.is_some_and(|ordered| ordered.order == PortOrder::AcknowledgeFault), is_passed_on);
        let answered = if is_passed_on { vec![] } else { vec![(id::ACKNOWLEDGE_FAST_STOP, Status::E_SUCCESS)] };
        assert_eq!(bench.sent(), answered, "{fault_code}");
    }
}

#[test]
fn fast_stop_behind_a_fault_is_judged_like_any_other() {
    let id = FastStopId::generate();
    for (cause, may_clear) in [(FastStopCause::UnannouncedDisconnect, true), (FastStopCause::Unknown, false)] {
        let mut bench = Bench { state: State { fault_code: 30, ..state() }, ..Bench::new() };
        bench.send(id::ACKNOWLEDGE_FAST_STOP, b"ack");
        let ask = bench.order().ask;
        bench.state = latched(id, cause);
        bench.answer(ask, PortReply::NoFault);
        let order = bench.device.poll_order().map(|ordered| ordered.order);
        assert_eq!(order, may_clear.then_some(PortOrder::Acknowledge(id)), "{cause:?}");
        let refused = if may_clear { vec![] } else { vec![(id::ACKNOWLEDGE_FAST_STOP, Status::E_ACCESS_DENIED)] };
        assert_eq!(bench.sent(), refused, "{cause:?}");
        assert!(may_clear || !acknowledges(&mut bench), "a refusal does not show the FAST STOP");
    }
}

#[test]
fn refusals_name_their_cause() {
    let mut bench = Bench::new();
    bench.send(id::ACKNOWLEDGE_FAST_STOP, b"");
    bench.send(id::ACKNOWLEDGE_FAST_STOP, b"nak");
    let mut damaged = Vec::new();
    crate::wsg::frame::encode(id::HOMING, &[0], &mut damaged);
    *damaged.last_mut().unwrap() ^= 1;
    bench.device.receive(bench.now, &damaged, &bench.state);
    let refused: Vec<_> = std::iter::from_fn(|| bench.device.poll_refused()).collect();
    assert_eq!(
        refused.iter().map(|refused| (refused.id, refused.status)).collect::<Vec<_>>(),
        [
            (id::ACKNOWLEDGE_FAST_STOP, Status::E_CMD_FORMAT_ERROR),
            (id::ACKNOWLEDGE_FAST_STOP, Status::E_CMD_FORMAT_ERROR),
            (id::HOMING, Status::E_CHECKSUM_ERROR),
        ]
    );
    assert!(refused[0].cause.to_string().contains("0 bytes were given"), "{}", refused[0].cause);
    assert!(refused[2].cause.to_string().contains("checksum"), "{}", refused[2].cause);
    // A motion that a Stop has withdrawn does not count as refused.
    bench.send(id::LOOP, b"x");
    bench.send(id::HOMING, &[0]);
    bench.send(id::STOP, &[]);
    assert_eq!(bench.device.poll_refused(), None);
}
