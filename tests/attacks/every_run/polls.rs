//! Requests that wait for a motion that never ends.

use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::time::sleep;

use crate::attack::{self, MANY};
use crate::attacker::{Attacker, Crowd};
use crate::device::Device;
use crate::gateway::{Gateway, Limits};
use crate::http;

const POLLS: usize = 1100;

/// Pause between an answer and the next request.
const AGAIN_AFTER: Duration = Duration::from_millis(100);

/// The motion that all of them wait for. It runs on the other gripper, which only the last FAST STOPs affect.
const MOVE: &str = r#"{"width_mm": 20, "speed_mm_s": 50, "request_id": "the only one"}"#;

/// Starts one motion, and waits for it by the same request and by its id.
pub fn begin(crowd: &Arc<Crowd>, count: usize) {
    let begun = http::post(crowd.address, "/api/v1/grippers/h/move?wait_ms=0", MOVE).expect("an answer");
    let body: serde_json::Value = serde_json::from_str(&begun.body).unwrap();
    let id = body["id"].as_str().unwrap_or_else(|| panic!("no command: {body}")).to_owned();
    let wait = move |crowd: Arc<Crowd>, index: usize, mut stream: tokio::net::TcpStream| {
        let request = match index % 2 {
            0 => http::request("POST", "/api/v1/grippers/h/move?wait_ms=60000", MOVE),
            _ => http::request("GET", &format!("/api/v1/grippers/h/commands/{id}?wait_ms=60000"), ""),
        };
        async move {
            stream.write_all(request.as_bytes()).await?;
            let _inside = crowd.inside();
            let mut buffer = [0; 2048];
            while stream.read(&mut buffer).await? > 0 {
                sleep(AGAIN_AFTER).await;
                stream.write_all(request.as_bytes()).await?;
            }
            Ok(())
        }
    };
    crowd.each(count, wait);
}

#[test]
fn long_polls_block_no_client() {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::start(&g, &h, Limits::Inherited);
    let begin = || Attacker::start("long_polls", POLLS, gateway.address);
    attack::run("1100 long polls", MANY, (&gateway, &g), begin, |_, _| {}).blocks_no_client();
}
