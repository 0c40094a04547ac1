//! A machine with more busy threads than processors.

use std::sync::Arc;

use crate::attack::{self, Wanted};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::every_run::healthy_socket;
use crate::gateway::{Gateway, Limits};
use crate::probe::Way;

/// The threads that do nothing else.
const LOOPS: usize = 8;

const OBSERVERS: usize = 300;

/// As many by WebSocket as by HTTP: their medians are compared.
const WANTED: Wanted = Wanted { http: 60, others: 60 };

/// Observers, and then threads that never rest.
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
fn sockets_are_as_quick_as_http_on_a_busy_machine() {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || Attacker::start_selfish("busy_observers", OBSERVERS, gateway.address);
    let row = attack::run("8 busy loops, 300 observers", WANTED, (&gateway, &g), begin, |_, _| {});
    let median = |way| row.by(way).percentile(50).expect("one has reached the device");
    let (socket, http) = (median(Way::OpenWebSocket), median(Way::FreshHttp));
    println!("the median by an open WebSocket is {socket:?}, by fresh HTTP connections {http:?}");
    assert!(socket <= 2 * http, "the median by an open WebSocket is {socket:?}, by fresh HTTP connections {http:?}");
    for (way, stops) in &row.stops {
        assert_eq!(stops.reached(), stops.wanted, "{way:?}");
    }
}
