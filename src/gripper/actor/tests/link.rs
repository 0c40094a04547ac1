//! Setting up the device again, and releasing it to another program.

use super::*;
use model::error::Conflict;
use wsg::{Data, Force, VerbatimCommand};

fn disconnect(rig: &mut Rig) -> oneshot::Receiver<Result<(), Rejection>> {
    rig.request(|answer| ActorRequest::Disconnect { client: client(), lease: None, answer })
}

fn flags_update(rig: &mut Rig) {
    let flags = rig.device.flags.bits().to_le_bytes();
    rig.reply(id::GET_SYSTEM_STATE, Status::E_SUCCESS, &flags);
}

fn set_force_limit(rig: &mut Rig, n: f32) -> oneshot::Receiver<Result<Data, Rejection>> {
    let command = Command::SetForceLimit(Force::new(n).unwrap());
    rig.request(|answer| ActorRequest::Exchange { command, client: client(), lease: None, answer: (None, answer) })
}

#[test]
fn new_setup_keeps_the_value_of_a_setter_in_flight() {
    let mut rig = Rig::connected(config(UDP));
    assert!(set_force_limit(&mut rig, 10.0).try_recv().unwrap().is_ok());
    // Updates every 10 ms, and then a pause, as in a restart of the device.
    for _ in 0..2 {
        rig.now.instant += Duration::from_millis(10);
        flags_update(&mut rig);
    }
    rig.now.instant += Duration::from_millis(900);
    rig.device.held.insert(id::SET_FORCE_LIMIT);
    let mut answered = set_force_limit(&mut rig, 30.0);
    rig.now.instant += Duration::from_millis(200);
    flags_update(&mut rig);
    rig.exchange();
    assert_ne!(rig.state().link, model::Link::Connected);
    rig.device.held.clear();
    rig.device.force_n = 30.0;
    rig.reply(id::SET_FORCE_LIMIT, Status::E_SUCCESS, &[]);
    rig.exchange();
    // Setup continues when no duplicate is awaited any longer, and so does the read-back.
    for _ in 0..2 {
        rig.pass(10);
    }
    assert_eq!(rig.state().link, model::Link::Connected);
    assert_eq!(answered.try_recv().unwrap(), Ok(Data::ForceLimit(Force::new(30.0).unwrap())));
    assert!((rig.device.force_n - 30.0).abs() < 0.1, "{} N", rig.device.force_n);
}

#[test]
fn verbatim_request_reaches_the_device_past_limits_and_recent_values() {
    let mut rig = Rig::connected(config(TCP));
    let mut send = |id, payload: &[u8]| {
        let command = Command::Verbatim(VerbatimCommand::new(id, payload.to_vec()).unwrap());
        let exchange =
            |answer| ActorRequest::Exchange { command, client: client(), lease: None, answer: (None, answer) };
        rig.device.received.clear();
        let answered = rig.request(exchange).try_recv().unwrap();
        (answered, rig.device.received.clone())
    };
    for _ in 0..2 {
        let (answered, received) = send(id::GET_FORCE_LIMIT, &[]);
        assert_eq!(answered, Ok(Data::ForceLimit(Force::new(40.0).unwrap())));
        assert_eq!(received, [(id::GET_FORCE_LIMIT, vec![])]);
    }
    // The gateway learns what the device makes of a value beyond its limits.
    let force = 300_f32.to_le_bytes().to_vec();
    let (answered, received) = send(id::SET_FORCE_LIMIT, &force);
    assert_eq!(answered, Ok(Data::ForceLimit(Force::new(300.0).unwrap())));
    assert_eq!(received, [(id::SET_FORCE_LIMIT, force), (id::GET_FORCE_LIMIT, vec![])]);
}

#[test]
fn released_device_sends_no_more_updates() {
    let mut rig = Rig::connected(config(UDP));
    drop(disconnect(&mut rig));
    let switched_off: Vec<_> = rig.device.received.iter().map(|(id, payload)| (*id, payload[0])).collect();
    assert_eq!(switched_off, [0x45, 0x44, 0x43, 0x41, 0x40].map(|id| (id, 0)), "the flags last");
    assert_eq!(rig.actor.wants_close(), Some(Close::Drained));
}

#[test]
fn unconfirmed_fast_stop_forbids_a_disconnect() {
    let mut rig = Rig::connected(config(TCP));
    rig.device.held.insert(id::FAST_STOP);
    let id = rig.fast_stop();
    let unconfirmed = Err(Conflict::FastStopUnconfirmed { id }.into());
    assert_eq!(disconnect(&mut rig).try_recv().unwrap(), unconfirmed);
    rig.actor.link_down(rig.now, "unplugged");
    assert_eq!(disconnect(&mut rig).try_recv().unwrap(), unconfirmed, "it is sent once the link is back");
    assert!(!rig.actor.is_released());
}
