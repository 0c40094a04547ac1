//! A gateway with few file descriptors.

use std::time::Duration;

use crate::attack::{self, SOME};
use crate::attacker::Attacker;
use crate::device::Device;
use crate::gateway::{Gateway, Limits};

/// Default limits of a service.
const USUAL: Limits = Limits::Descriptors { soft: 1024, hard: 20_000 };

/// Slightly fewer WebSockets than the soft limit allows.
const SOCKETS: usize = 988;

const RECONNECTS_WITHIN: Duration = Duration::from_secs(3);

#[test]
fn default_descriptor_limit_blocks_no_client() {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, USUAL);
    let begin = || Attacker::start("healthy_sockets", SOCKETS, gateway.address);
    let mut reconnected_after = None;
    let row = attack::run("988 WebSockets, soft limit 1024", SOME, (&gateway, &g), begin, |_, _| {
        reconnected_after = g.reconnect_time(3 * RECONNECTS_WITHIN);
    });
    println!("the device was reconnected after {reconnected_after:?}");
    let is_soon = reconnected_after.is_some_and(|after| after <= RECONNECTS_WITHIN);
    assert!(is_soon, "the device was reconnected after {reconnected_after:?}");
    row.blocks_no_client();
}

/// With one gripper, since each device takes a descriptor.
#[test]
fn hard_limit_of_64_descriptors_blocks_no_client() {
    let g = Device::start();
    let gateway = Gateway::of(&g, Limits::Descriptors { soft: 64, hard: 64 });
    let begin = || Attacker::start("half_sent_bodies", 200, gateway.address);
    let mut reconnected_after = None;
    let row = attack::run("200 half-sent bodies, hard limit 64", SOME, (&gateway, &g), begin, |_, _| {
        reconnected_after = g.reconnect_time(3 * RECONNECTS_WITHIN);
    });
    println!("the device was reconnected after {reconnected_after:?}");
    assert!(reconnected_after.is_some_and(|after| after <= RECONNECTS_WITHIN), "{reconnected_after:?}");
    row.blocks_no_client();
}
