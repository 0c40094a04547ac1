//! The conformance suite over TCP, UDP and pty, and tests of single transports.

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

/// A pty with a stable name, like that of a USB adapter.
fn serial() -> String {
    let link = std::env::temp_dir().join(format!("wsg-port-{}-{}", std::process::id(), free_udp_port()));
    format!("serial://pty?link={}", link.display())
}

conformance!(on_tcp, crate::device_link::transports::tcp());
conformance!(on_udp, crate::device_link::transports::udp());
conformance!(on_serial, crate::device_link::transports::serial(), run by crate::harness::on_pty);

#[tokio::test]
async fn cut_on_udp_is_noticed() {
    conformance::cut_without_a_connection(&udp()).await;
}

#[tokio::test]
async fn device_on_all_addresses_prints_a_usable_one() {
    let served = served(&format!("udp://0.0.0.0:0?reply_port={}", free_udp_port())).await;
    assert!(served.address.to_string().starts_with("udp://127.0.0.1:"), "{}", served.address);
}
