//! Stops with a unique request id each, from a client without the lease.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpSocket;

use crate::attack::{self, SOME};
use crate::attacker::{Attacker, Crowd};
use crate::device::{Device, STOP};
use crate::gateway::{Gateway, Limits};
use crate::http;

/// More ids than the gateway remembers.
const IDS: usize = 70_000;

/// Time to send the ids.
const SENT_WITHIN: Duration = Duration::from_mins(2);

const CONNECTIONS: usize = 8;
const IN_A_ROW: usize = 50;

/// Address of the attackers, which makes them a different client from the holder.
const ELSEWHERE: &str = "127.0.0.2:0";

const REACHES_WITHIN: Duration = Duration::from_secs(1);

/// Sends Stops as fast as they are answered.
pub fn begin(crowd: &Arc<Crowd>, count: usize) {
    for index in 0..count {
        let crowd = crowd.clone();
        tokio::spawn(async move {
            for round in 0.. {
                // Reconnect however the connection ended.
                let _ = Box::pin(stops(&crowd, &format!("{index}-{round}"))).await;
            }
        });
    }
}

async fn stops(crowd: &Crowd, prefix: &str) -> std::io::Result<()> {
    let socket = TcpSocket::new_v4()?;
    socket.bind(ELSEWHERE.parse().map_err(std::io::Error::other)?)?;
    let mut stream = socket.connect(crowd.address).await?;
    crowd.opened();
    let _inside = crowd.inside();
    let mut buffer = [0; 16 * 1024];
    for row in 0.. {
        let stop = |index| {
            let body = format!(r#"{{"request_id": "{prefix}-{row}-{index}"}}"#);
            http::request("POST", "/api/v1/grippers/h/stop?wait_ms=0", &body)
        };
        let requests: String = (0..IN_A_ROW).map(stop).collect();
        stream.write_all(requests.as_bytes()).await?;
        let mut answers = 0;
        while answers < IN_A_ROW {
            let read = stream.read(&mut buffer).await?;
            if read == 0 {
                return Ok(());
            }
            // A status line split across two reads is not counted; the next batch compensates.
            answers += buffer[..read].windows(9).filter(|bytes| bytes == b"HTTP/1.1 ").count();
            if read < 200 {
                break;
            }
        }
        crowd.sent(IN_A_ROW);
    }
    Ok(())
}

/// Sends a request, and returns status and body of the answer.
fn post(address: SocketAddr, path: &str, body: &Value) -> (u16, Value) {
    let path = format!("/api/v1/grippers/h/{path}");
    let answer = http::post(address, &path, &body.to_string()).expect("an answer");
    (answer.status, serde_json::from_str(&answer.body).unwrap())
}

/// Starts and stops a motion as the holder, after another client has used up its ids.
fn holder_moves_and_stops(gateway: &Gateway, h: &Device) {
    let (status, lease) = post(gateway.address, "lease", &json!({"holder": "the holder", "ttl_ms": 60_000}));
    assert_eq!(status, 200, "{lease}");
    let token = &lease["token"];
    let (status, moved) = post(
        gateway.address,
        "move?wait_ms=0",
        &json!({"width_mm": 20, "speed_mm_s": 50, "lease": token, "request_id": "the motion"}),
    );
    assert_eq!(status, 202, "the holder's motion with an id: {moved}");
    let start = Instant::now();
    let (status, stopped) = post(gateway.address, "stop", &json!({"lease": token, "request_id": "the stop"}));
    assert_eq!(status, 200, "the holder's Stop with an id: {stopped}");
    assert!(h.first_since(STOP, start, REACHES_WITHIN).is_some(), "22h reaches the device");
}

#[test]
fn request_ids_of_one_client_leave_room_for_the_holder() {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || Attacker::start("stops_with_ids", CONNECTIONS, gateway.address);
    let row = attack::run("Stops with an id each", SOME, (&gateway, &g), begin, |attacker, _| {
        let start = Instant::now();
        while attacker.done().sent < IDS && start.elapsed() < SENT_WITHIN {
            std::thread::sleep(Duration::from_millis(100));
        }
        println!("stops_with_ids: {:?}, {} frames 22h", attacker.done(), h.count(STOP));
    });
    holder_moves_and_stops(&gateway, &h);
    row.blocks_no_client();
}
