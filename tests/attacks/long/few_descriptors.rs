//! Attacks on a gateway with few file descriptors: it must never exceed its limit.

use std::time::Duration;

use crate::attack::{self, SOME};
use crate::attacker::Attacker;
use crate::device::Device;
use crate::gateway::{Gateway, Limits};

const DESCRIPTORS: u32 = 600;

const RECONNECTS_WITHIN: Duration = Duration::from_secs(3);

fn attacked_by(attack: &str, count: usize) {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Descriptors { soft: DESCRIPTORS, hard: DESCRIPTORS });
    let begin = || Attacker::start(attack, count, gateway.address);
    let mut reconnected_after = None;
    let row = attack::run(&format!("{attack}, limit 600"), SOME, (&gateway, &g), begin, |_, _| {
        reconnected_after = g.reconnect_time(3 * RECONNECTS_WITHIN);
    });
    println!("the device was reconnected after {reconnected_after:?}");
    assert!(!gateway.log().contains("os error 24"), "the gateway ran out of descriptors");
    assert!(reconnected_after.is_some_and(|after| after <= RECONNECTS_WITHIN), "{reconnected_after:?}");
    // With this few descriptors, a poller can lose its connection among a thousand others.
    row.reaches_the_device();
}

#[test]
fn half_sent_bodies_leave_descriptors() {
    attacked_by("half_sent_bodies", 1024);
}

#[test]
fn long_polls_leave_descriptors() {
    attacked_by("long_polls", 1100);
}

#[test]
fn held_connections_leave_descriptors() {
    attacked_by("connect_and_hold", 1);
}
