//! Long answers that are never read.

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

/// The bound on what their answers may take.
const MOST_MB: usize = 100;

/// The kernel's buffer of one that reads nothing.
const BUFFER: usize = 2048;

/// The interval at which one that reads nothing looks whether its connection has ended.
const LOOKS_EVERY: Duration = Duration::from_secs(1);

/// Asks for the document of the API, and reads nothing.
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
        // An end that is not read is noticed by the next request.
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
    row.keeps_nobody_out();
}
