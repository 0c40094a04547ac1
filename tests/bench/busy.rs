//! Time of a FAST STOP to the device while eight busy loops occupy the processors: over WebSocket, compared with HTTP,
//! alternating in one run.
//!
//! `cargo bench --bench busy`. Variables: `LOOPS` (8) and `STOPS` (40 of each kind). Times are noisy; compare the ratio.

mod program;
mod socket;
mod stopper;
mod tap;
mod variables;

use std::hint::black_box;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use futures_util::SinkExt as _;
use program::{Error, start};
use serde_json::json;
use socket::connect;
use stopper::{Stopper, percentile};
use tokio_tungstenite::tungstenite::Message;
use variables::number;

/// Unmeasured stops of each kind at the start.
const WARM_UP: usize = 5;

fn main() -> Result<(), Error> {
    let (_device, device) = start(&["sim", "tcp://127.0.0.1:0"], " at tcp://")?;
    let (tapped, stops) = tap::start(device)?;
    let gripper = format!("g=tcp://{tapped}");
    let arguments = ["--listen", "127.0.0.1:0", "--zenoh-listen", "tcp/127.0.0.1:0", "--gripper", &gripper];
    let (_gateway, address) = start(&arguments, " at http://")?;
    let stopper = Stopper::new(&address, stops)?;
    let is_over = Arc::new(AtomicBool::new(false));
    for _ in 0..number("LOOPS", 8) {
        let is_over = is_over.clone();
        std::thread::spawn(move || {
            while !is_over.load(Ordering::Relaxed) {
                black_box(());
            }
        });
    }
    let count = number("STOPS", 40).max(1);
    let (mut by_http, mut by_socket) = (Vec::new(), Vec::new());
    let stop_by_socket = || {
        // A fresh socket for each stop: pings go unanswered while this client only sends.
        let mut socket = stopper.runtime.block_on(connect(&address, None))?;
        let request = json!({"jsonrpc": "2.0", "id": 1, "method": "fast-stop", "params": {"gripper": "g"}}).to_string();
        stopper.stop_by(|| Ok(stopper.runtime.block_on(socket.send(Message::text(request)))?))
    };
    for round in 0..WARM_UP + count {
        let (http, socket) = if round % 2 == 0 {
            let http = stopper.stop()?;
            (http, stop_by_socket()?)
        } else {
            let socket = stop_by_socket()?;
            (stopper.stop()?, socket)
        };
        if round >= WARM_UP {
            by_http.push(http);
            by_socket.push(socket);
        }
    }
    is_over.store(true, Ordering::Relaxed);
    report(&mut by_http, &mut by_socket);
    Ok(())
}

fn report(by_http: &mut [Duration], by_socket: &mut [Duration]) {
    by_http.sort_unstable();
    by_socket.sort_unstable();
    for (name, percent) in [("p50", 50), ("p90", 90)] {
        let (http, socket) = (percentile(by_http, percent), percentile(by_socket, percent));
        let ratio = socket.as_secs_f64() / http.as_secs_f64();
        println!("{name} of {}: HTTP {http:?}, WebSocket {socket:?}, ratio {ratio:.2}", by_http.len());
    }
}
