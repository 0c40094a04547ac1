//! Requests with unfinished heads.

use std::io;
use std::sync::Arc;

use tokio::net::TcpStream;

use crate::attack::{self, MANY};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::gateway::{Gateway, Limits};

/// Sends the beginning of a head, every third one of a FAST STOP, and waits for the end of the connection.
pub async fn half_head(crowd: Arc<Crowd>, index: usize, stream: TcpStream) -> io::Result<()> {
    let head = ["POST /api/v1/fast-stop HTTP/1.1\r\nHost: loc", "POST /api/v1/grippers/g/fast-st", "G"][index % 3];
    crowd.send_unfinished(stream, head).await
}

#[test]
fn half_heads_block_no_client() {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || Attacker::start("half_heads", 2000, gateway.address);
    attack::run("2000 half heads", MANY, (&gateway, &g), begin, |_, _| {}).blocks_no_client();
}
