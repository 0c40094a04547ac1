use tokio::sync::oneshot;

use super::*;
use model::Door;
use model::error::Failure;
use wsg::Command;
use wsg::session::{Request, Session, SessionConfig};

fn acknowledge_frame(now: Instant) -> Token {
    let frame_gap = Duration::from_millis(100);
    let config = SessionConfig { bytes_per_second: None, frame_gap, may_duplicate: false, nonce_seed: 1 };
    let [reply_within, result_within] = [Duration::from_secs(1); 2];
    let request = Request { command: Command::AcknowledgeFastStop, reply_within, result_within };
    Session::new(config, now).submit(now, request).unwrap()
}

#[test]
fn standing_flags_explain_no_fast_stop() {
    let (soft, finger) = (SystemState::SOFT_LIMIT_PLUS, SystemState::FINGER_FAULT);
    let (none, stop, hot) = (SystemState::empty(), SystemState::FAST_STOP, SystemState::TEMP_FAULT);
    let late = 60_000;
    for (updates, expected) in [
        (vec![(0, soft | stop)], FastStopCause::Unknown),
        (vec![(0, none), (late, soft), (late, soft | stop)], FastStopCause::Unknown),
        (vec![(0, none), (late, finger), (late, finger | stop)], FastStopCause::Unknown),
        (vec![(0, none), (late, soft | stop)], FastStopCause::SoftLimit),
        (vec![(0, none), (late, soft), (10, soft | stop)], FastStopCause::SoftLimit),
        (vec![(0, none), (late, finger | stop)], FastStopCause::FingerFault),
        (vec![(0, hot | stop)], FastStopCause::TemperatureFault),
    ] {
        let (mut latch, mut ids, mut now) = (LatchState::default(), IdSource::new(1), Now::read());
        for (after_ms, flags) in &updates {
            now.instant += Duration::from_millis(*after_ms);
            latch.take_flags(now, *flags, &mut Origin { ids: &mut ids, unannounced: false });
        }
        assert_eq!(latch.current().map(|latch| latch.cause), Some(expected), "{updates:?}");
    }
}

#[test]
fn device_that_leaves_a_requested_fast_stop_is_stopped_again() {
    let now = Now::read();
    for (is_requested, is_acknowledging) in [(true, false), (true, true), (false, false)] {
        let (mut ids, mut latch) = (IdSource::new(1), LatchState::default());
        let client = Client::new("test", Door::Http);
        if is_requested {
            let (id, at) = (ids.fast_stop_id(now.wall), now.instant);
            let (cause, reason) = (FastStopCause::Requested, Reason::truncated(""));
            latch.request(now, FastStopRequest { id, client: client.clone(), cause, reason, at, epoch: None });
            latch.sent(now.instant, None);
        }
        let mut take_flags = |latch: &mut LatchState, flags| {
            latch.take_flags(now, flags, &mut Origin { ids: &mut ids, unannounced: false })
        };
        take_flags(&mut latch, SystemState::FAST_STOP);
        assert!(latch.current().unwrap().confirmed);
        let token = acknowledge_frame(now.instant);
        if is_acknowledging {
            latch.acknowledge_begun(latch.id(), client, token, oneshot::channel().0);
        }
        let is_forgotten = is_requested && !is_acknowledging;
        let expected = is_forgotten.then_some(LatchChange::Forgotten);
        assert_eq!(take_flags(&mut latch, SystemState::empty()), expected);
        assert_eq!(latch.is_due(now.instant), is_forgotten);
        if is_acknowledging {
            // The reply of the acknowledgement was lost.
            let timeout = Failure::DeviceTimeout { command: "AcknowledgeFastStop", waited_ms: 1000 };
            latch.acknowledge_ended(now.instant, token, Err(timeout.into()));
            assert_eq!(take_flags(&mut latch, SystemState::empty()), Some(LatchChange::Forgotten));
        }
    }
}

#[test]
fn only_flags_after_the_reply_decide_an_acknowledge() {
    let answered = Now::read();
    let later = Now { instant: answered.instant + CLEARS_WITHIN, ..answered };
    for (flags, cleared) in [(SystemState::empty(), true), (SystemState::FAST_STOP, false)] {
        let mut ids = IdSource::new(1);
        let mut latch = LatchState::default();
        let mut take_flags = |latch: &mut LatchState, now, flags| {
            latch.take_flags(now, flags, &mut Origin { ids: &mut ids, unannounced: false })
        };
        let seen = take_flags(&mut latch, answered, SystemState::FAST_STOP);
        assert_eq!(seen, Some(LatchChange::Seen { overtaken: None }));
        let id = latch.id().unwrap();
        let client = Client::new("test", Door::Http);
        let token = acknowledge_frame(answered.instant);
        latch.acknowledge_begun(Some(id), client, token, oneshot::channel().0);
        latch.acknowledge_ended(answered.instant, token, Ok(()));
        // The gateway was stalled, so it still has the flags from before the reply.
        latch.handle_timeout(later.instant, Some(SystemState::FAST_STOP));
        assert!(latch.take_acknowledged().is_empty());
        assert_eq!(take_flags(&mut latch, later, flags), cleared.then_some(LatchChange::Cleared));
        latch.handle_timeout(later.instant, Some(flags));
        let told = latch.take_acknowledged().pop().unwrap().result;
        assert_eq!(told.is_ok(), cleared, "{told:?}");
    }
}
