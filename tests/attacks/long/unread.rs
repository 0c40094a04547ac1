//! Long answers that the client never reads.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;
use tokio::time::sleep;

use crate::attack::{self, MANY};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::gateway::{Gateway, Limits};
use crate::http;

const CONNECTIONS: usize = 2000;

/// Memory limit of the unread answers.
const MOST_MB: usize = 100;

/// Kernel receive buffer of a client that reads nothing.
const BUFFER: usize = 2048;

/// Interval at which such a client checks its connection.
const LOOKS_EVERY: Duration = Duration::from_secs(1);

/// Requests the OpenAPI document, and reads nothing.
pub async fn unread(crowd: Arc<Crowd>, _: usize, mut stream: TcpStream) -> io::Result<()> {
    socket2::SockRef::from(&stream).set_recv_buffer_size(BUFFER)?;
    stream.set_zero_linger()?;
    stream.write_all(http::request("GET", "/api/v1/openapi.json", "").as_bytes()).await?;
    let _inside = crowd.inside();
    loop {
        sleep(LOOKS_EVERY).await;
        if let Some(error) = stream.take_error()? {
            return Err(error);
        }
        // The next write detects a close that was not read.
        stream.write_all(b"\r\n").await?;
    }
}

#[test]
fn unread_answers_take_little_memory() {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || Attacker::start("unread_answers", CONNECTIONS, gateway.address);
    let row = attack::run("2000 unread answers", MANY, (&gateway, &g), begin, |_, _| {});
    row.memory_stays_below(row.before.rss_mb + MOST_MB);
    row.blocks_no_client();
}
