//! Observers of all topics at the highest rate, over server-sent events and over WebSocket.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::attack::{self, MANY, Row};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::every_run::subscribed;
use crate::gateway::{Gateway, Limits};
use crate::http;
use crate::probe::Way;

const OBSERVERS: usize = 900;

/// Noise of a shared machine: lower times are not compared.
const NOISE: Duration = Duration::from_millis(10);

/// Reads an event stream.
pub async fn by_stream(crowd: Arc<Crowd>, _: usize, stream: TcpStream) -> io::Result<()> {
    followed(crowd, stream, "topics=events,state,telemetry,frames,fleet&max_hz=100").await
}

/// Reads an event stream with this query.
pub async fn followed(crowd: Arc<Crowd>, mut stream: TcpStream, query: &str) -> io::Result<()> {
    let path = &format!("/api/v1/stream?{query}");
    stream.write_all(http::request("GET", path, "").as_bytes()).await?;
    let _inside = crowd.inside();
    let mut buffer = vec![0; 16 * 1024];
    loop {
        match stream.read(&mut buffer).await? {
            0 => return Ok(()),
            bytes => crowd.sent(bytes),
        }
    }
}

/// Reads a WebSocket.
pub async fn by_socket(crowd: Arc<Crowd>, _: usize, stream: TcpStream) -> io::Result<()> {
    let params = r#"{"topics": ["events", "state", "telemetry", "frames", "fleet"], "max_hz": 100}"#;
    subscribed(crowd, stream, params).await
}

/// Runs observers while the other gripper moves, so that each of its updates is a change.
fn observed_by(attack: &str) -> Row {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || {
        let motion = r#"{"width_mm": 20, "speed_mm_s": 50}"#;
        let begun = http::post(gateway.address, "/api/v1/grippers/h/move?wait_ms=0", motion).unwrap();
        assert_eq!(begun.status, 202, "{}", begun.body);
        Attacker::start(attack, OBSERVERS, gateway.address)
    };
    attack::run(&format!("900 observers, {attack}"), MANY, (&gateway, &g), begin, |attacker, _| {
        println!("{attack}: {:?}", attacker.done());
    })
}

#[test]
fn streams_cost_no_more_than_sockets() {
    let (sockets, streams) = (observed_by("all_by_socket"), observed_by("all_by_stream"));
    let slowest = |row: &Row| row.by(Way::FreshHttp).percentile(99).expect("a FAST STOP reached the device");
    let (by_socket, by_stream) = (slowest(&sockets), slowest(&streams));
    assert!(
        by_stream <= (2 * by_socket).max(NOISE),
        "p99 with event streams {by_stream:?}, with WebSockets {by_socket:?}"
    );
    for row in [sockets, streams] {
        let http = row.by(Way::FreshHttp);
        assert_eq!((http.reached(), row.polls.lost), (http.wanted, 0));
    }
}
