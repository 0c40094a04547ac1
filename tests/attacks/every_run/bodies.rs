//! Requests with unfinished bodies.

use std::io;
use std::sync::Arc;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::attack::{self, MANY};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::gateway::{Gateway, Limits};

/// Maximum number of connections in the gateway.
const ALL_SLOTS: usize = 1024;

/// Sends a whole head and one byte of the body, and waits for the end of the connection.
pub async fn half_sent_body(crowd: Arc<Crowd>, index: usize, mut stream: TcpStream) -> io::Result<()> {
    let (method, host) = match index % 4 {
        0 => ("POST", "localhost"),
        1 => ("GET", "localhost"),
        2 => ("POST", "foreign.example"),
        _ => ("PUT", "foreign.example"),
    };
    let path = ["/api/v1/grippers/g/move", "/api/v1/grippers/g/state", "/api/v1/grippers"][index % 3];
    let head = format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\nContent-Length: 100\r\n\r\n{{");
    stream.write_all(head.as_bytes()).await?;
    let _inside = crowd.inside();
    let mut buffer = [0; 512];
    while stream.read(&mut buffer).await? > 0 {}
    Ok(())
}

fn attacked_by(count: usize) {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || Attacker::start("half_sent_bodies", count, gateway.address);
    attack::run(&format!("{count} half-sent bodies"), MANY, (&gateway, &g), begin, |_, _| {}).blocks_no_client();
}

#[test]
fn half_sent_bodies_block_no_client() {
    attacked_by(ALL_SLOTS);
}

#[test]
fn excess_half_sent_bodies_block_no_client() {
    attacked_by(3500);
}
