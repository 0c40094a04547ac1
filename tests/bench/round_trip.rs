//! Round trip of a Loop through the gateway over HTTP, compared with a direct TCP connection, alternating in one run.
//!
//! `cargo bench --bench round_trip`. Times are noisy; compare the ratio.

mod program;

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use program::{Error, start};
use wsg_gateway::wsg::{self, ChecksumEvaluation, Decoded, Decoder, LoopData, id};

/// Measured round trips of each kind.
const ROUNDS: usize = 2000;

/// Unmeasured round trips at the start.
const WARM_UP: usize = 200;

fn main() -> Result<(), Error> {
    let (_straight, straight) = start(&["sim", "tcp://127.0.0.1:0"], " at tcp://")?;
    let (_behind, behind) = start(&["sim", "tcp://127.0.0.1:0"], " at tcp://")?;
    let gripper = format!("g=tcp://{behind}");
    let (_gateway, gateway) =
        start(&["--listen", "127.0.0.1:0", "--zenoh-listen", "tcp/127.0.0.1:0", "--gripper", &gripper], " at http://")?;

    let mut device = TcpStream::connect(straight)?;
    device.set_nodelay(true)?;
    let mut frame = Vec::new();
    let data = LoopData::new(vec![0x55; 16]).ok_or("too long")?;
    wsg::Command::Loop(data).encode(&mut frame);

    let client = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let http = reqwest::Client::new();
    let url = format!("http://{gateway}/api/v1/grippers/g/loop");
    let body = format!("{{\"data\":\"{}\"}}", "55".repeat(16));
    wait_until_ready(&client, &http, &format!("http://{gateway}/api/v1/grippers/g/state"))?;

    let (mut direct, mut through) = (Vec::new(), Vec::new());
    for round in 0..WARM_UP + ROUNDS {
        let begun = Instant::now();
        loop_straight(&mut device, &frame)?;
        let straight = begun.elapsed();
        let begun = Instant::now();
        client.block_on(async {
            let answer = http.post(&url).body(body.clone()).send().await?.error_for_status()?;
            answer.bytes().await
        })?;
        if round >= WARM_UP {
            direct.push(straight);
            through.push(begun.elapsed());
        }
    }
    report(&mut direct, &mut through);
    Ok(())
}

fn wait_until_ready(client: &tokio::runtime::Runtime, http: &reqwest::Client, url: &str) -> Result<(), Error> {
    let deadline = Instant::now() + Duration::from_secs(5);
    while Instant::now() < deadline {
        let state: serde_json::Value = client.block_on(async { http.get(url).send().await?.json().await })?;
        if state["link"] == "connected" {
            return Ok(());
        }
    }
    Err("the gripper does not become ready".into())
}

fn loop_straight(device: &mut TcpStream, frame: &[u8]) -> Result<(), Error> {
    device.write_all(frame)?;
    let mut decoder = Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
    let mut bytes = [0; 512];
    loop {
        let read = device.read(&mut bytes)?;
        decoder.push(&bytes[..read]);
        while let Some(decoded) = decoder.next() {
            if matches!(decoded, Decoded::Frame(reply) if reply.id == id::LOOP) {
                return Ok(());
            }
        }
    }
}

fn report(direct: &mut [Duration], through: &mut [Duration]) {
    direct.sort_unstable();
    through.sort_unstable();
    println!("a Loop of 16 bytes, {ROUNDS} alternating round trips each");
    for (name, percent) in [("p50", 50), ("p99", 99)] {
        let of = |times: &[Duration]| times[(times.len() - 1) * percent / 100];
        let (direct, through) = (of(direct), of(through));
        let ratio = through.as_secs_f64() / direct.as_secs_f64();
        println!("{name}: direct {direct:?}, through the gateway over HTTP {through:?}, ratio {ratio:.2}");
    }
}
