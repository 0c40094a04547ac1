//! Connections that never send a byte.

use std::sync::Arc;

use tokio::net::TcpStream;

use crate::attack::{self, MANY};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::gateway::{Gateway, Limits};
use crate::probe::{Stops, Way};

/// Simultaneous connection attempts of the attack that closes at once.
const UNDER_WAY: usize = 32;

/// Number of FAST STOPs from clients that pause before their first byte.
const HESITANT: usize = 60;

/// Number of connections kept open; beyond it, the oldest is closed.
const HELD: usize = 4000;

/// Connects and closes as fast as one thread can. Closes with a reset, which leaves no port in TIME_WAIT.
pub fn close(crowd: &Arc<Crowd>, count: usize) {
    for index in 0..UNDER_WAY {
        let crowd = crowd.clone();
        tokio::spawn(async move {
            let _inside = (index == 0).then(|| (0..count).map(|_| crowd.inside()).collect::<Vec<_>>());
            loop {
                if let Ok(stream) = TcpStream::connect(crowd.address).await {
                    crowd.opened();
                    let _ = stream.set_zero_linger();
                }
            }
        });
    }
}

/// Connects and keeps the connections open, as fast as one thread can.
pub fn hold(crowd: &Arc<Crowd>, count: usize) {
    let crowd = crowd.clone();
    tokio::spawn(async move {
        let _inside: Vec<_> = (0..count).map(|_| crowd.inside()).collect();
        let mut held = std::collections::VecDeque::new();
        loop {
            if let Ok(stream) = TcpStream::connect(crowd.address).await {
                crowd.opened();
                let _ = stream.set_zero_linger();
                held.push_back(stream);
            }
            if held.len() > HELD {
                held.pop_front();
            }
            tokio::task::yield_now().await;
        }
    });
}

fn attacked_by(attack: &str) {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || Attacker::start_selfish(attack, 1, gateway.address);
    let mut hesitant = Stops::default();
    let row = attack::run(attack, MANY, (&gateway, &g), begin, |attacker, probe| {
        hesitant = probe.stops(Way::HesitantHttp, HESITANT);
        println!("{attack}: {} connections were opened", attacker.done().opened);
    });
    let (reached, slowest) = (hesitant.reached(), hesitant.percentile(100));
    println!("{attack}: {reached} of {HESITANT} hesitant FAST STOPs reached the device, the last after {slowest:?}");
    row.blocks_no_client();
    assert_eq!(reached, HESITANT, "hesitant FAST STOPs that reached the device");
}

#[test]
fn closed_connections_block_no_client() {
    attacked_by("connect_and_close");
}

#[test]
fn held_connections_block_no_client() {
    attacked_by("connect_and_hold");
}
