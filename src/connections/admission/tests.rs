use std::net::Ipv4Addr;

use super::*;

const HERE: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
const ELSEWHERE: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 7));

/// Returns an admission with one connection of each class, but two incoming and three streaming ones.
fn small() -> Arc<Admission> {
    let bounds = Bounds::narrow().with(Class::Incoming, 2).with(Class::Streaming, 3);
    Admission::new(bounds)
}

fn admit(admission: &Arc<Admission>, peer: IpAddr) -> Arc<ConnectionPermit> {
    Arc::new(admission.admit(peer, &CancellationToken::new()))
}

fn is_evicted(permit: &ConnectionPermit) -> bool {
    permit.evicted.is_cancelled()
}

#[test]
fn oldest_half_sent_request_gives_way() {
    let admission = small();
    let (first, second) = (admit(&admission, HERE), admit(&admission, HERE));
    first.receiving();
    let third = admit(&admission, HERE);
    assert!(is_evicted(&first) && !is_evicted(&second), "a newer connection can still bring a FAST STOP");
    drop(second.claim(Class::Answering).unwrap());
    let fourth = admit(&admission, HERE);
    second.receiving();
    assert!(is_evicted(&third) && !is_evicted(&second) && !is_evicted(&fourth), "a reused connection");
}

#[test]
fn silent_connection_is_spared_before_newer_half_sent_ones_for_a_moment() {
    let (mut table, start) = (Table::new(Bounds::narrow().with(Class::Incoming, 2)), Instant::now());
    let mut admit = |after_ms, is_silent: bool| {
        let evicted = CancellationToken::new();
        let id = table.admit(HERE, start + Duration::from_millis(after_ms), evicted.clone());
        if !is_silent {
            table.begun(id);
        }
        evicted
    };
    let (silent, half_sent) = (admit(0, true), admit(4, false));
    let next = admit(4, false);
    assert!(half_sent.is_cancelled() && !silent.is_cancelled(), "a FAST STOP may follow");
    admit(6, false);
    assert!(next.is_cancelled() && !silent.is_cancelled());
    admit(7, false);
    assert!(silent.is_cancelled());
}

#[tokio::test(start_paused = true)]
async fn listener_waits_for_silent_connections_a_fifth_of_the_time() {
    let admission = Admission::new(Bounds { displaced: 1, ..Bounds::narrow() });
    let mut patience = Patience::default();
    let mut waits = async || {
        let begun = tokio::time::Instant::now();
        patience.wait(&admission).await;
        begun.elapsed()
    };
    let silent = admit(&admission, HERE);
    assert_eq!(waits().await, Duration::ZERO, "the silent connection would find a displaced slot");
    let _displaced = admission.displaced().unwrap();
    let first = waits().await;
    assert!(first >= table::SILENT_FOR && first < 2 * table::SILENT_FOR, "{first:?}");
    drop(silent);
    let silent = admit(&admission, HERE);
    assert_eq!(waits().await, Duration::ZERO, "rests");
    drop(silent);
    tokio::time::advance(4 * first).await;
    let silent = admit(&admission, HERE);
    assert!(waits().await >= table::SILENT_FOR, "has rested");
    drop(silent);
    tokio::time::advance(4 * first).await;
    let heard = admit(&admission, HERE);
    heard.begun();
    assert_eq!(waits().await, Duration::ZERO, "a connection that has sent something gives way at once");
}

#[test]
fn request_being_answered_is_kept_and_idle_again_afterwards() {
    let admission = small();
    let first = admit(&admission, HERE);
    let answering = first.claim(Class::Answering).unwrap();
    let flood: Vec<_> = (0..9).map(|_| admit(&admission, HERE)).collect();
    assert!(!is_evicted(&first) && flood.iter().rev().take(2).all(|permit| !is_evicted(permit)));
    drop(answering);
    // One idle connection is allowed.
    let second = admit(&admission, HERE);
    drop(second.claim(Class::Answering).unwrap());
    assert!(is_evicted(&first) && !is_evicted(&second));
}

#[test]
fn full_class_refuses_requests_but_not_fast_stop() {
    let admission = small();
    let permits: Vec<_> = (0..3).map(|_| admit(&admission, HERE)).collect();
    let _answering = permits[1].claim(Class::Answering).unwrap();
    assert!(permits[2].claim(Class::Answering).is_none());
    let _stopping = permits[2].claim(Class::Urgent).unwrap();
    let other = admit(&admission, HERE);
    assert!(other.claim(Class::Urgent).is_some());
    assert!(is_evicted(&permits[2]), "its FAST STOP continues without the connection");
}

#[test]
fn peer_with_most_streams_gives_way_to_others() {
    let admission = small();
    let stream = |peer| {
        let permit = admit(&admission, peer);
        permit.claim(Class::Streaming).map(|claim| (permit, claim))
    };
    let here: Vec<_> = (0..3).map(|_| stream(HERE).unwrap()).collect();
    assert!(stream(HERE).is_none());
    let _first = stream(ELSEWHERE).unwrap();
    assert!(is_evicted(&here[0].0) && !is_evicted(&here[1].0));
    // Two here and one elsewhere is the most even split of three.
    assert!(stream(ELSEWHERE).is_none() && stream(HERE).is_none());
}

#[test]
fn lease_holder_never_gives_way() {
    let admission = small();
    let holder = admit(&admission, HERE);
    let (_stream, _pin) = (holder.claim(Class::Streaming).unwrap(), holder.claim(Class::Pinned).unwrap());
    let stream = |peer| {
        let permit = admit(&admission, peer);
        permit.claim(Class::Streaming).map(|claim| (permit, claim))
    };
    let others: Vec<_> = (0..3).map(|_| stream(HERE).unwrap()).collect();
    let _foreign = stream(ELSEWHERE).unwrap();
    assert!(!is_evicted(&holder) && is_evicted(&others[0].0));
}

#[test]
fn long_poll_that_gives_way_keeps_its_connection() {
    let admission = Admission::new(Bounds::narrow().with(Class::Incoming, 9).with(Class::Waiting, 2));
    let [first, second, third] = [HERE, HERE, HERE].map(|peer| admit(&admission, peer));
    let waiting = (first.claim(Class::Waiting).unwrap(), second.claim(Class::Waiting).unwrap());
    assert!(third.claim(Class::Waiting).is_none());
    let foreign = admit(&admission, ELSEWHERE);
    let _claim = foreign.claim(Class::Waiting).unwrap();
    assert!(waiting.0.yielded.is_cancelled() && !waiting.1.yielded.is_cancelled());
    assert!(!is_evicted(&first));
    drop(waiting);
}

#[test]
fn end_of_a_motion_evicts_no_long_poll() {
    let admission = Admission::new(Bounds::of(Bounds::MAX_DESCRIPTORS));
    let poll = |_| {
        let permit = admit(&admission, HERE);
        let _answering = permit.claim(Class::Answering).unwrap();
        let waiting = permit.claim(Class::Waiting);
        if waiting.is_none() {
            // Answered early.
            permit.demote();
        }
        (permit, waiting)
    };
    let (permits, waiting): (Vec<_>, Vec<_>) = (0..1100).map(poll).unzip();
    assert!(waiting.iter().any(Option::is_none));
    drop(waiting);
    // Clients that were answered early ask again.
    for permit in &permits {
        drop(permit.claim(Class::Answering).unwrap());
    }
    assert!(!permits.iter().any(|permit| is_evicted(permit)));
}

#[test]
fn demoted_connection_gives_way_before_idle_ones() {
    let admission = Admission::new(Bounds::narrow().with(Class::Incoming, 1).with(Class::Answering, 2));
    let poller = admit(&admission, HERE);
    drop(poller.claim(Class::Answering).unwrap());
    let greedy = admit(&admission, HERE);
    let answering = greedy.claim(Class::Answering).unwrap();
    greedy.demote();
    drop(answering);
    let _newcomer = admit(&admission, HERE);
    assert!(is_evicted(&greedy) && !is_evicted(&poller));
}

#[test]
fn largest_holder_of_bytes_is_evicted_first() {
    let bounds = Bounds { held_bytes: 1000, ..Bounds::of(Bounds::MAX_DESCRIPTORS) };
    let admission = Admission::new(bounds);
    let (small, large) = (admit(&admission, HERE), admit(&admission, ELSEWHERE));
    let (mut of_small, mut of_large) = (small.held(), large.held());
    of_large.set(700);
    of_small.set(300);
    assert!(!is_evicted(&large) && !is_evicted(&small));
    of_small.set(301);
    assert!(is_evicted(&large) && !is_evicted(&small));
    of_small.set(1000);
    assert!(!is_evicted(&small), "bytes of an evicted connection no longer count");
    drop((of_large, large));
    of_small.set(1000);
    assert!(!is_evicted(&small));
}

#[test]
fn evicted_fast_stop_lingers_unless_many_others_leave() {
    let admission = small();
    let permits: Vec<_> = (0..3).map(|_| admit(&admission, HERE)).collect();
    assert_eq!((permits[0].linger(), permits[0].linger_for_fast_stop()), (Duration::ZERO, LINGER));
    let _fourth = admit(&admission, HERE);
    assert_eq!(permits[0].linger_for_fast_stop(), Duration::ZERO);
    assert!(is_evicted(&permits[0]) && is_evicted(&permits[1]));
}

#[tokio::test]
async fn accepting_waits_for_evicted_connections_to_end() {
    use futures_util::FutureExt as _;
    let admission = small();
    let permits: Vec<_> = (0..3).map(|_| admit(&admission, HERE)).collect();
    assert!(admission.has_room().now_or_never().is_none());
    drop(permits);
    admission.has_room().await;
}

#[test]
fn one_ipv6_network_is_one_peer() {
    let admission = Admission::new(Bounds::narrow().with(Class::Incoming, 3));
    let address = |text: &str| text.parse::<IpAddr>().unwrap();
    let foreign = admit(&admission, address("2001:db8:0:1::1"));
    let flood: Vec<_> = (2..6).map(|n| admit(&admission, address(&format!("2001:db8:0:2::{n}")))).collect();
    assert!(!is_evicted(&foreign) && is_evicted(&flood[0]) && is_evicted(&flood[1]));
}

#[test]
fn all_are_evicted_on_closing() {
    let (admission, closing) = (small(), CancellationToken::new());
    let permit = admission.admit(HERE, &closing);
    closing.cancel();
    assert!(is_evicted(&permit));
}

#[tokio::test]
async fn pinned_connections_are_bounded() {
    let admission = Admission::new(Bounds::of(Bounds::MAX_DESCRIPTORS));
    let closing = CancellationToken::new();
    let permits: Vec<_> = (0..100).map(|_| Arc::new(admission.admit(HERE, &closing))).collect();
    let pins: Vec<_> = permits.iter().filter_map(|permit| permit.claim(Class::Pinned)).collect();
    assert!((1..=16).contains(&pins.len()), "{}", pins.len());
}
