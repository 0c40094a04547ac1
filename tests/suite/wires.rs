//! The conformance suite on the transports that every machine has, and what is particular to each.

use std::net::UdpSocket;

use crate::conformance;
use crate::conformance::rig::served;

/// A UDP port that is free at the moment.
pub fn free_udp_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn tcp() -> String {
    "tcp://127.0.0.1:0".to_owned()
}

fn udp() -> String {
    format!("udp://127.0.0.1:0?reply_port={}", free_udp_port())
}

/// A pty under a name that stays, as a USB adapter's does.
fn serial() -> String {
    let link = std::env::temp_dir().join(format!("wsg-port-{}-{}", std::process::id(), free_udp_port()));
    format!("serial://pty?link={}", link.display())
}

conformance!(on_tcp, crate::wires::tcp());
conformance!(on_udp, crate::wires::udp());
conformance!(on_serial, crate::wires::serial());

#[tokio::test]
async fn a_cut_on_udp_is_seen_and_what_was_sent_into_it_is_lost() {
    conformance::a_cut_without_a_connection(&udp()).await;
}

#[tokio::test]
async fn a_device_that_listens_on_all_addresses_says_one_that_a_gateway_can_use() {
    let served = served(&format!("udp://0.0.0.0:0?reply_port={}", free_udp_port())).await;
    assert!(served.address.to_string().starts_with("udp://127.0.0.1:"), "{}", served.address);
}
