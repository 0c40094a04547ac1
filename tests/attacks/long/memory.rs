//! WebSockets that send expensive requests and read nothing.

use std::io;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::time::sleep;

use crate::attack::{self, SOME};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::gateway::{Gateway, Limits};
use crate::websocket::{KEY, PONG, Socket, TEXT, frame, upgrade};

/// Limit on the gateway's memory.
const MOST_MB: usize = 300;

/// Limit on the gateway's address space, which protects the machine.
const ENDS_AT_MB: u32 = 4096;

/// Payload of the longest message that the gateway accepts.
const LONGEST: usize = 64 * 1024;

/// Minimum time between two messages of the whole crowd, so that the senders do not starve the probe.
const SENDS_EVERY: Duration = Duration::from_micros(125);

/// Minimum duration of the attack.
const LASTS: Duration = Duration::from_secs(30);

const LIVES_EVERY: Duration = Duration::from_millis(500);

/// Repeats the most expensive messages, and reads only the answer to the upgrade.
pub async fn greedy_socket(crowd: Arc<Crowd>, index: usize, mut stream: TcpStream) -> io::Result<()> {
    stream.set_zero_linger()?;
    stream.write_all(upgrade(KEY).as_bytes()).await?;
    let mut buffer = [0; 512];
    let read = stream.read(&mut buffer).await?;
    if !buffer[..read].starts_with(b"HTTP/1.1 101") {
        return Ok(());
    }
    let _inside = crowd.inside();
    if index % 5 == 4 {
        return all_but_the_last_byte(&mut stream).await;
    }
    let (message, pause) = (message(index), SENDS_EVERY * crowd.count as u32);
    loop {
        stream.write_all(&frame(TEXT, message.as_bytes())).await?;
        crowd.sent(1);
        sleep(pause).await;
    }
}

/// A long id with a known or unknown method, a long payload, or a batch of long ids.
fn message(index: usize) -> String {
    let id = "i".repeat(60 * 1000);
    match index % 5 {
        0 => format!(r#"{{"jsonrpc": "2.0", "id": "{id}", "method": "none"}}"#),
        1 => format!(r#"{{"jsonrpc": "2.0", "id": "{id}", "method": "state", "params": {{"gripper": "g"}}}}"#),
        2 => {
            let params = format!(r#"{{"gripper": "g", "data": "{}"}}"#, "ab".repeat(256));
            format!(r#"{{"jsonrpc": "2.0", "id": "{}", "method": "loop", "params": {params}}}"#, &id[..59_000])
        }
        _ => {
            let one = format!(r#"{{"jsonrpc": "2.0", "id": "{}", "method": "none"}}"#, &id[..1900]);
            format!("[{}]", vec![one; 32].join(","))
        }
    }
}

/// Sends all of a fragmented message except its last fragment.
async fn all_but_the_last_byte(stream: &mut TcpStream) -> io::Result<()> {
    let mut begin = frame(TEXT, &vec![b' '; LONGEST - 1]);
    begin[0] &= 0x7F;
    stream.write_all(&begin).await?;
    loop {
        sleep(LIVES_EVERY).await;
        stream.write_all(&frame(PONG, &[])).await?;
    }
}

fn attacked_by(count: usize) {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Memory { mb: ENDS_AT_MB });
    let start = Instant::now();
    let begin = || Attacker::start("greedy_sockets", count, gateway.address);
    let mut has_opened = false;
    let row = attack::run(&format!("{count} greedy WebSockets"), SOME, (&gateway, &g), begin, |attacker, _| {
        std::thread::sleep(LASTS.saturating_sub(start.elapsed()));
        has_opened = Socket::open(&gateway).is_some();
        println!("greedy_sockets: {:?}", attacker.done());
    });
    row.memory_stays_below(MOST_MB);
    assert!(has_opened || count > 1000, "another WebSocket can still be opened");
    row.blocks_no_client();
}

#[test]
fn greedy_sockets_take_little_memory() {
    attacked_by(40);
}

#[test]
fn maximum_greedy_sockets_take_little_memory() {
    attacked_by(1008);
}
