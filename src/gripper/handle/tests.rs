use futures_util::FutureExt as _;

use super::*;
use crate::fake;
use model::Door;

/// A handle whose requests stay in the queue.
fn idle() -> (Handle, mpsc::Receiver<ActorRequest>) {
    let (requests, queue) = mpsc::channel(MAX_WAITING_REQUESTS);
    let (handle, _) = fake::gripper("left", fake::FakeScript::default());
    (Handle { requests, ..handle }, queue)
}

#[tokio::test]
async fn flood_of_reads_does_not_reject_stops_or_lease_requests() {
    let (handle, mut queue) = idle();
    let client = Client::new("test", Door::Http);
    let reads: Vec<_> = (0..MAX_WAITING_REQUESTS).map(|_| Box::pin(handle.lease())).collect();
    let mut reads: Vec<_> = reads.into_iter().map(|mut read| ((&mut read).now_or_never(), read)).collect();
    assert!(reads.iter().all(|(answered, _)| answered.is_none()), "each has a slot");
    let refused = handle.lease().now_or_never();
    assert_eq!(refused, Some(Err(Failure::Overloaded { limit: MAX_WAITING_REQUESTS })));
    let token = LeaseToken::generate();
    let stop = Submission { client: client.clone(), action: Action::Stop, request_id: None, lease: None };
    let mut asked = [
        handle.submit(stop).map(drop).boxed(),
        handle.release_lease(Some(token.clone())).map(drop).boxed(),
        handle.renew_lease(Some(token.clone())).map(drop).boxed(),
        handle.take_lease(TakeLease::by(client.clone())).map(drop).boxed(),
        handle.hand_over(Some(token), "other".to_owned()).map(drop).boxed(),
        handle.acknowledge(FastStopId::generate(), client.clone()).map(drop).boxed(),
        handle.cancel(CommandId::generate(), client).map(drop).boxed(),
    ];
    tokio::task::yield_now().await;
    for asked in &mut asked {
        assert!(asked.now_or_never().is_none(), "waits for a slot");
    }
    for _ in 0..asked.len() {
        // Renews the task's budget, so that each future can be polled.
        tokio::task::yield_now().await;
        assert!(matches!(queue.try_recv(), Ok(ActorRequest::Lease { .. })));
        let refused = handle.lease().now_or_never();
        assert_eq!(refused, Some(Err(Failure::Overloaded { limit: MAX_WAITING_REQUESTS })), "waiters go first");
        for asked in &mut asked {
            assert!(asked.now_or_never().is_none(), "not answered yet");
        }
    }
    for _ in asked.len()..MAX_WAITING_REQUESTS {
        assert!(matches!(queue.try_recv(), Ok(ActorRequest::Lease { .. })));
    }
    reads.clear();
    let mut next = || queue.try_recv().unwrap();
    assert!(matches!(next(), ActorRequest::Submit { .. }));
    assert!(matches!(next(), ActorRequest::ReleaseLease { .. }));
    assert!(matches!(next(), ActorRequest::RenewLease { .. }));
    assert!(matches!(next(), ActorRequest::TakeLease { .. }));
    assert!(matches!(next(), ActorRequest::HandOver { .. }));
    assert!(matches!(next(), ActorRequest::Acknowledge { .. }));
    assert!(matches!(next(), ActorRequest::Cancel { .. }));
}

#[tokio::test(start_paused = true)]
async fn reply_to_a_fast_stop_says_whether_it_is_confirmed() {
    for confirms in [true, false] {
        let (handle, _seen) = fake::gripper("left", fake::FakeScript { confirms, ..fake::FakeScript::default() });
        let id = FastStopId::generate();
        let stop = handle.fast_stop(id, Client::new("test", Door::Http), Reason::truncated("")).await;
        assert_eq!((stop.id, stop.confirmed), (id, confirms));
    }
}

#[tokio::test]
async fn last_state_does_not_look_current() {
    let (handle, queue) = idle();
    assert_eq!(handle.state().link, Link::Connecting);
    drop(queue);
    let state = handle.state();
    assert_eq!((state.link, state.fault, state.fault_code), (Link::Reconnecting, true, Fault::LinkDown.code()));
    assert!(state.link_cause.as_ref().is_some_and(|cause| cause.contains("disconnected")), "{state:?}");
}
