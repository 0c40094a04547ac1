//! A machine with more busy threads than processors.

use std::sync::Arc;

use crate::attack::{self, Wanted};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::every_run::healthy_socket;
use crate::gateway::{Gateway, Limits};
use crate::probe::Way;

/// Number of busy threads.
const LOOPS: usize = 8;

const OBSERVERS: usize = 300;

/// Equal numbers over WebSocket and HTTP, so that their medians are comparable.
const WANTED: Wanted = Wanted { http: 60, others: 60 };

/// Starts observers, then busy threads.
pub fn begin(crowd: &Arc<Crowd>, count: usize) {
    crowd.each(count, healthy_socket);
    for _ in 0..LOOPS {
        std::thread::spawn(|| {
            loop {
                std::hint::spin_loop();
            }
        });
    }
}

#[test]
fn sockets_are_as_fast_as_http_on_a_busy_machine() {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || Attacker::start_selfish("busy_observers", OBSERVERS, gateway.address);
    let row = attack::run("8 busy loops, 300 observers", WANTED, (&gateway, &g), begin, |_, _| {});
    let median = |way| row.by(way).percentile(50).expect("a FAST STOP reached the device");
    let (socket, http) = (median(Way::OpenWebSocket), median(Way::FreshHttp));
    println!("the median over an open WebSocket is {socket:?}, over fresh HTTP connections {http:?}");
    assert!(socket <= 2 * http, "median over an open WebSocket {socket:?}, over fresh HTTP connections {http:?}");
    for (way, stops) in &row.stops {
        assert_eq!(stops.reached(), stops.wanted, "{way:?}");
    }
}
