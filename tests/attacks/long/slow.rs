//! Clients that send or read one byte a second.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::time::sleep;

use crate::attack::{self, MANY};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::gateway::{Gateway, Limits};
use crate::http;

const A_BYTE_EVERY: Duration = Duration::from_secs(1);

/// Kernel receive buffer of a slow reader.
const BUFFER: usize = 2048;

/// More clients than the gateway admits at a time; one in eight reads.
const TRICKLERS: usize = 1300;
const READS_EACH: usize = 8;

/// Sends a body or reads a long answer, one byte a second.
pub async fn trickler(crowd: Arc<Crowd>, index: usize, mut stream: TcpStream) -> io::Result<()> {
    socket2::SockRef::from(&stream).set_recv_buffer_size(BUFFER)?;
    let _inside = crowd.inside();
    if !index.is_multiple_of(READS_EACH) {
        let head = "POST /api/v1/grippers/g/move HTTP/1.1\r\nHost: localhost\r\nContent-Length: 60000\r\n\r\n{";
        stream.write_all(head.as_bytes()).await?;
        loop {
            sleep(A_BYTE_EVERY).await;
            stream.write_all(b" ").await?;
        }
    }
    stream.write_all(http::request("GET", "/api/v1/openapi.json", "").as_bytes()).await?;
    let mut byte = [0; 1];
    while stream.read(&mut byte).await? > 0 {
        sleep(A_BYTE_EVERY).await;
    }
    Ok(())
}

#[test]
fn tricklers_block_no_client() {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || Attacker::start("tricklers", TRICKLERS, gateway.address);
    attack::run("1300 tricklers", MANY, (&gateway, &g), begin, |_, _| {}).blocks_no_client();
}
