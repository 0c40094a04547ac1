//! Crowds on Modbus and the WSG port, and FAST STOPs that one gripper is flooded with.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::attack::{self, Row, Wanted};
use crate::attacker::{Attacker, Crowd};
use crate::device::{Device, FAST_STOP};
use crate::gateway::{Gateway, Limits};
use crate::harness::wsg;

/// More connections than Modbus admitted when it had 64 slots.
const IDLE: usize = 250;
const BUSY: usize = 120;
const FLOODING: usize = 40;

const WANTED: Wanted = Wanted { http: 20, others: 20 };

/// Memory of a gateway while one gripper is flooded with FAST STOPs.
const FLOODED_MB: usize = 80;

/// Sends nothing, and waits for the end of the connection.
pub async fn idle(crowd: Arc<Crowd>, _: usize, mut stream: TcpStream) -> io::Result<()> {
    let _inside = crowd.inside();
    let mut buffer = [0; 64];
    while stream.read(&mut buffer).await? > 0 {}
    Ok(())
}

/// Reads the input registers of `g` as fast as it gets responses.
pub async fn cyclic_reads(crowd: Arc<Crowd>, _: usize, mut stream: TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let _inside = crowd.inside();
    let mut response = [0; 9 + 2 * 12];
    loop {
        stream.write_all(&[0, 1, 0, 0, 0, 6, 1, 4, 0, 100, 0, 12]).await?;
        stream.read_exact(&mut response).await?;
        crowd.sent(1);
    }
}

/// Sends FAST STOPs for `h` over Modbus without waiting for the responses.
pub async fn modbus_stops(crowd: Arc<Crowd>, _: usize, stream: TcpStream) -> io::Result<()> {
    let pair = [[0, 1, 0, 0, 0, 6, 2, 6, 0, 110, 0, 1], [0, 2, 0, 0, 0, 6, 2, 6, 0, 110, 0, 0]].concat();
    flood(crowd, stream, &pair).await
}

/// Sends FAST STOPs over a WSG port without waiting for the replies.
pub async fn port_stops(crowd: Arc<Crowd>, _: usize, stream: TcpStream) -> io::Result<()> {
    flood(crowd, stream, &wsg::request(FAST_STOP, &[])).await
}

async fn flood(crowd: Arc<Crowd>, stream: TcpStream, request: &[u8]) -> io::Result<()> {
    let requests = request.repeat(32);
    let (mut reader, mut writer) = stream.into_split();
    let _inside = crowd.inside();
    let read = async {
        let mut buffer = [0; 4096];
        while reader.read(&mut buffer).await? > 0 {}
        Ok(())
    };
    let write = async {
        loop {
            writer.write_all(&requests).await?;
            crowd.sent(32);
        }
    };
    tokio::select! {
        ended = read => ended,
        ended = write => ended,
    }
}

/// Attacks the address of a gateway that `at` selects.
pub fn attacked(name: &str, count: usize, wanted: Wanted, at: impl Fn(&Gateway) -> SocketAddr) -> Row {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || Attacker::start(name, count, at(&gateway));
    attack::run(&format!("{count} {name}"), wanted, (&gateway, &g), begin, |attacker, _| {
        println!("{name}: {:?}", attacker.done());
    })
}

pub fn modbus(gateway: &Gateway) -> SocketAddr {
    gateway.modbus.expect("Modbus is served")
}

pub fn other_port(gateway: &Gateway) -> SocketAddr {
    gateway.other_port.expect("a WSG port of h is served")
}

#[test]
fn idle_modbus_connections_block_no_client() {
    attacked("idle", IDLE, WANTED, modbus).answers_every_client();
}

#[test]
fn idle_port_connections_block_no_client() {
    attacked("idle", IDLE, WANTED, |gateway| gateway.port).answers_every_client();
}

#[test]
fn busy_modbus_connections_block_no_client() {
    attacked("cyclic_reads", BUSY, WANTED, modbus).answers_every_client();
}

#[test]
fn modbus_stops_of_another_gripper_block_no_client() {
    let row = attacked("modbus_stops", FLOODING, WANTED, modbus);
    row.answers_every_client();
    row.memory_stays_below(FLOODED_MB);
}

#[test]
fn port_stops_of_another_gripper_block_no_client() {
    let row = attacked("port_stops", FLOODING, WANTED, other_port);
    row.answers_every_client();
    row.memory_stays_below(FLOODED_MB);
}
