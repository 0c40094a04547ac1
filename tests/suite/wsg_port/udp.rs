//! UDP clients, each identified by its reply address.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use serde_json::json;
use tokio::net::UdpSocket;

use super::{ABORTED, ACCESS_DENIED, MOVE, SUCCESS};
use crate::harness::wsg::{PENDING, move_to, request};
use crate::harness::{DEADLINE, Gateway, Proxy, Simulator};

async fn port(proxy: &Proxy, option: &str) -> (Gateway, SocketAddr) {
    let gripper = format!("g=tcp://{}", proxy.address);
    let port = format!("g=udp://127.0.0.1:0{option}");
    let gateway = Gateway::start(&["--gripper", &gripper, "--wsg-port", &port]).await;
    gateway.until_link("connected").await;
    let port = gateway.word_after("WSG port of g: udp://").await.parse().unwrap();
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    (gateway, port)
}

async fn client() -> UdpSocket {
    UdpSocket::bind("127.0.0.1:0").await.unwrap()
}

async fn next(socket: &UdpSocket) -> (u8, u16) {
    let mut datagram = [0; 512];
    let received = tokio::time::timeout(DEADLINE, socket.recv(&mut datagram)).await.expect("a datagram");
    assert_eq!(received.unwrap(), 8 + usize::from(datagram[4]), "one frame a datagram");
    (datagram[3], u16::from_le_bytes([datagram[6], datagram[7]]))
}

async fn ask(socket: &UdpSocket, port: SocketAddr, id: u8, payload: &[u8]) -> u16 {
    socket.send_to(&request(id, payload), port).await.unwrap();
    let (answered, status) = next(socket).await;
    assert_eq!(answered, id);
    status
}

#[tokio::test]
async fn client_silent_for_three_seconds_is_lost() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let (gateway, port) = port(&proxy, "?reply_port=sender").await;
    let (one, two) = (client().await, client().await);
    assert_eq!(ask(&one, port, MOVE, &move_to(5.0, 5.0)).await, PENDING);
    let silent = Instant::now();
    assert_eq!(ask(&two, port, MOVE, &move_to(50.0, 50.0)).await, ACCESS_DENIED, "another address is another client");
    assert_eq!(ask(&two, port, 0x40, &[0; 3]).await, SUCCESS);
    gateway.until("the client is lost", |state| state["fast_stop_cause"] == "client_lost").await;
    let lost = silent.elapsed();
    let state = gateway.until("the device stops", |state| state["fast_stop_confirmed"] == true).await;
    assert!(lost > Duration::from_millis(2900) && lost < Duration::from_secs(6), "{lost:?}");
    assert_eq!((&state["lease_holder"], proxy.frames.count(0x23)), (&json!(null), 1), "{state}");
    assert_eq!(next(&one).await, (MOVE, ABORTED), "the silent client still gets its status");
}

/// The rest of a datagram that was cut short never comes.
#[tokio::test]
async fn datagram_cut_short_hides_no_further_ones() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let (_gateway, port) = port(&proxy, "?reply_port=sender").await;
    let client = client().await;
    for id in [0x06, 0x21, 0xB5] {
        client.send_to(&request(id, &[0; 200])[..40], port).await.unwrap();
        assert_eq!(ask(&client, port, 0x50, &[]).await, SUCCESS, "{id:02X}h");
    }
}

/// Drivers without a time-out that wait for the end of a motion send nothing in the meantime.
#[tokio::test]
async fn silence_limit_is_configurable() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let (gateway, port) = port(&proxy, "?reply_port=sender&lost_after_ms=20000").await;
    let socket = client().await;
    let begun = Instant::now();
    // 85 mm or more at 20 mm/s.
    assert_eq!(ask(&socket, port, MOVE, &move_to(5.0, 20.0)).await, PENDING);
    assert_eq!(next(&socket).await, (MOVE, SUCCESS));
    assert!(begun.elapsed() > Duration::from_secs(3), "silent for longer than the default");
    assert_eq!(gateway.state().await["lease_holder"], "wsg:127.0.0.1");
}

#[tokio::test]
async fn client_that_polls_stays_connected() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let (gateway, port) = port(&proxy, "?reply_port=sender").await;
    let socket = client().await;
    assert_eq!(ask(&socket, port, MOVE, &move_to(5.0, 20.0)).await, PENDING);
    let begun = Instant::now();
    // At 20 mm/s, 85 mm or more take longer than the silence limit.
    let ended = loop {
        socket.send_to(&request(0x43, &[0; 3]), port).await.unwrap();
        if let (MOVE, status) = next(&socket).await {
            break status;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    assert!(begun.elapsed() > Duration::from_secs(3));
    assert_eq!((ended, &gateway.state().await["fast_stop"]), (SUCCESS, &json!(false)));
}

#[tokio::test]
async fn announced_disconnect_stops_the_motion() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let (gateway, port) = port(&proxy, "?reply_port=sender").await;
    let socket = client().await;
    assert_eq!(ask(&socket, port, MOVE, &move_to(5.0, 5.0)).await, PENDING);
    gateway.until_moving().await;
    socket.send_to(&request(0x07, &[]), port).await.unwrap();
    // A device without connections would answer E_NOT_AVAILABLE; the port has a session for each client.
    let mut replies = [next(&socket).await, next(&socket).await];
    replies.sort_unstable();
    assert_eq!(replies, [(0x07, SUCCESS), (MOVE, ABORTED)]);
    let state = gateway.until_standing().await;
    assert!(state["fast_stop"] == false && state["lease_holder"].is_null(), "{state}");
    assert_eq!((proxy.frames.count(0x22), proxy.frames.count(0x23)), (1, 0));
}

#[tokio::test]
async fn replies_go_to_the_configured_port() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let (sender, receiver) = (client().await, client().await);
    let option = format!("?reply_port={}", receiver.local_addr().unwrap().port());
    let (_gateway, port) = port(&proxy, &option).await;
    sender.send_to(&request(0x50, &[]), port).await.unwrap();
    assert_eq!(next(&receiver).await, (0x50, SUCCESS));
}

/// Clients that share a reply port cannot tell their replies apart, so they count as one. A driver with a new socket
/// for each request is one client.
#[tokio::test]
async fn clients_with_one_reply_port_are_one_client() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let receiver = client().await;
    let option = format!("?reply_port={}", receiver.local_addr().unwrap().port());
    let (_gateway, port) = port(&proxy, &option).await;
    for (width, expected) in [(60.0, PENDING), (50.0, PENDING)] {
        client().await.send_to(&request(MOVE, &move_to(width, 300.0)), port).await.unwrap();
        assert_eq!(next(&receiver).await, (MOVE, expected));
        assert_eq!(next(&receiver).await, (MOVE, SUCCESS));
    }
    // More sources than the client limit, and each is answered.
    for _ in 0..40 {
        client().await.send_to(&request(0x06, b"x"), port).await.unwrap();
        assert_eq!(next(&receiver).await, (0x06, SUCCESS));
    }
}

#[tokio::test]
async fn fast_stop_passes_the_client_limit() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let (gateway, port) = port(&proxy, "?reply_port=sender").await;
    let (holder, mut others) = (client().await, Vec::new());
    assert_eq!(ask(&holder, port, MOVE, &move_to(60.0, 300.0)).await, PENDING);
    assert_eq!(next(&holder).await, (MOVE, SUCCESS));
    for _ in 0..40 {
        let other = client().await;
        assert_eq!(ask(&other, port, 0x50, &[]).await, SUCCESS);
        others.push(other);
    }
    assert_eq!(ask(&client().await, port, 0x23, &[]).await, SUCCESS);
    assert_eq!(gateway.state().await["fast_stop_cause"], "requested");
}
