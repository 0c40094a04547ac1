//! Recordings match the simulated device, and the transports reproduce them byte for byte.

use std::io;
use std::os::fd::OwnedFd;

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, UdpSocket};
use tokio::time::timeout;
use wsg_gateway::transport::can::segment::{Reassembler, slices};
use wsg_gateway::transport::{Address, Pipe};

use crate::conformance::rig::SOON;
use crate::device_link::transports::free_udp_port;
use crate::recordings::{self, Exchange, TRANSPORTS};

#[test]
fn every_command_and_reply_is_as_recorded() {
    for (transport, interface) in TRANSPORTS {
        recordings::compare(transport, interface);
    }
}

async fn connect(url: &str) -> Pipe {
    url.parse::<Address>().unwrap().connect().await.unwrap()
}

async fn send(pipe: &mut Pipe, exchange: &Exchange) {
    pipe.writer.write_all(&exchange.request_bytes()).await.unwrap();
    pipe.writer.flush().await.unwrap();
}

async fn expect(pipe: &mut Pipe, exchange: &Exchange) {
    let mut received = vec![0; exchange.reply_bytes().len()];
    timeout(SOON, pipe.reader.read_exact(&mut received)).await.unwrap().unwrap();
    assert_eq!(received, exchange.reply_bytes());
}

#[tokio::test]
async fn tcp_has_the_recorded_stream() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let mut pipe = connect(&format!("tcp://{}", listener.local_addr().unwrap())).await;
    let (mut device, _) = listener.accept().await.unwrap();
    for exchange in recordings::read("tcp") {
        send(&mut pipe, &exchange).await;
        let mut request = vec![0; exchange.request_bytes().len()];
        device.read_exact(&mut request).await.unwrap();
        assert_eq!(request, exchange.request_bytes());
        device.write_all(&exchange.reply_bytes()).await.unwrap();
        expect(&mut pipe, &exchange).await;
    }
}

#[tokio::test]
async fn udp_has_the_recorded_datagrams() {
    let device = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let local_port = free_udp_port();
    let mut pipe = connect(&format!("udp://{}?local_port={local_port}", device.local_addr().unwrap())).await;
    let mut datagram = [0; 1000];
    for exchange in recordings::read("udp") {
        send(&mut pipe, &exchange).await;
        let bytes = timeout(SOON, device.recv(&mut datagram)).await.unwrap().unwrap();
        assert_eq!(datagram[..bytes], recordings::bytes(&exchange.requests[0]));
        for reply in &exchange.replies {
            device.send_to(&recordings::bytes(reply), ("127.0.0.1", local_port)).await.unwrap();
        }
        expect(&mut pipe, &exchange).await;
    }
}

fn pty() -> (std::fs::File, String) {
    let master: OwnedFd = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
    (master.into(), name)
}

#[tokio::test]
async fn serial_line_has_the_recorded_stream() {
    let (mut device, path) = pty();
    let mut pipe = connect(&format!("serial://{path}?baud=460800")).await;
    for exchange in recordings::read("serial") {
        send(&mut pipe, &exchange).await;
        let mut request = vec![0; exchange.request_bytes().len()];
        io::Read::read_exact(&mut device, &mut request).unwrap();
        assert_eq!(request, exchange.request_bytes());
        io::Write::write_all(&mut device, &exchange.reply_bytes()).unwrap();
        expect(&mut pipe, &exchange).await;
    }
}

/// Segmentation in both directions, without a bus. The `can` tests use a real one.
#[test]
fn can_has_the_recorded_frames() {
    let mut reassembler = Reassembler::default();
    for exchange in recordings::read("can") {
        let request = exchange.request_bytes();
        let cut: Vec<_> = slices(&request).map(|slice| format!("064#{}", hex::encode_upper(slice))).collect();
        assert_eq!(cut, exchange.requests);
        let mut stream = Vec::new();
        for reply in &exchange.replies {
            let (id, slice) = recordings::can_frame(reply);
            assert_eq!(id, "065");
            stream.extend_from_slice(reassembler.push(&slice));
        }
        assert_eq!(stream, exchange.reply_bytes());
    }
}
