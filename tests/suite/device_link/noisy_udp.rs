//! Lost, duplicated and reordered datagrams affect at most the command that they belong to.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use tokio::net::UdpSocket;
use wsg_gateway::model::Link;
use wsg_gateway::transport::{Address, UdpAddress};
use wsg_gateway::wsg::{Command, Data, LoopData};

use crate::conformance::rig::{Rig, SOON, served, spawn};
use crate::device_link::transports::free_udp_port;

/// Faults of the network, with counters.
#[derive(Default)]
struct Network {
    is_bad: AtomicBool,
    lost: AtomicU32,
    doubled: AtomicU32,
    swapped: AtomicU32,
}

impl Network {
    /// Returns the datagrams that arrive in place of this one.
    fn pass(&self, rng: &mut SmallRng, held: &mut Option<Vec<u8>>, datagram: Vec<u8>) -> Vec<Vec<u8>> {
        let mut arriving = vec![datagram];
        if self.is_bad.load(Ordering::Relaxed) {
            match rng.random_range(0..20) {
                0 => {
                    self.lost.fetch_add(1, Ordering::Relaxed);
                    arriving.clear();
                }
                1 => {
                    self.doubled.fetch_add(1, Ordering::Relaxed);
                    arriving.push(arriving[0].clone());
                }
                2 if held.is_none() => {
                    self.swapped.fetch_add(1, Ordering::Relaxed);
                    *held = arriving.pop();
                    return arriving;
                }
                _ => {}
            }
        }
        arriving.extend(held.take());
        arriving
    }
}

/// Forwards datagrams from one socket to an address.
async fn carry(network: Arc<Network>, from: UdpSocket, to: (&'static str, u16), seed: u64) {
    let sender = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let mut rng = SmallRng::seed_from_u64(seed);
    let (mut held, mut buffer) = (None, vec![0; 2000]);
    while let Ok(bytes) = from.recv(&mut buffer).await {
        for datagram in network.pass(&mut rng, &mut held, buffer[..bytes].to_vec()) {
            sender.send_to(&datagram, to).await.unwrap();
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn bad_network_affects_only_the_commands_that_it_hits() {
    let requests = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let replies = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let device = served(&format!("udp://127.0.0.1:0?reply_port={}", replies.local_addr().unwrap().port())).await;
    let Address::Udp(UdpAddress { port: device_port, .. }) = device.address else { panic!("the device is on UDP") };
    let (port, local_port) = (requests.local_addr().unwrap().port(), free_udp_port());
    let network = Arc::new(Network::default());
    tokio::spawn(carry(network.clone(), requests, ("127.0.0.1", device_port), 1));
    tokio::spawn(carry(network.clone(), replies, ("127.0.0.1", local_port), 2));
    let handle = spawn(Address::Udp(UdpAddress::new("127.0.0.1".to_owned(), port, local_port)));
    let rig = Rig { handle, switch: device.switch, is_tcp: false };
    rig.link(Link::Connected, SOON).await;

    network.is_bad.store(true, Ordering::Relaxed);
    let mut unanswered = 0;
    for n in 0..60u8 {
        let data = vec![n; 10];
        match rig.exchange(Command::Loop(LoopData::new(data.clone()).unwrap())).await {
            Ok(answer) => assert_eq!(answer, Data::Loop(data), "reply of another command"),
            Err(_) => unanswered += 1,
        }
    }
    assert_eq!(rig.handle.state().link, Link::Connected, "the link stays up");
    for (what, happened) in [("lost", &network.lost), ("doubled", &network.doubled), ("swapped", &network.swapped)] {
        assert!(happened.load(Ordering::Relaxed) > 0, "no datagram was {what}");
    }
    let lost = network.lost.load(Ordering::Relaxed) + network.swapped.load(Ordering::Relaxed);
    assert!(unanswered <= lost, "{unanswered} requests failed, but only {lost} datagrams were lost or late");

    network.is_bad.store(false, Ordering::Relaxed);
    for n in 60..80u8 {
        let data = vec![n; 10];
        let answer = rig.exchange(Command::Loop(LoopData::new(data.clone()).unwrap())).await;
        // The first can meet an id that stays closed until a late reply is impossible.
        assert!(answer == Ok(Data::Loop(data)) || n == 60, "{answer:?}");
    }
    rig.drain().await;
}
