//! Telemetry of one gripper to many subscribers over Zenoh, over WebSocket, and from a bare Zenoh publisher without the
//! gateway: rate and delay. Then the time of a FAST STOP put to the device, with and without a client that floods the
//! gateway and its subscribers with states.
//!
//! `cargo bench --bench zenoh`. Variables: `SUBSCRIBERS` (20), `SECONDS` (5 per measurement) and `STOPS` (100 per
//! series). Times are noisy, and telemetry times have whole milliseconds; compare the ratios.

mod program;
#[path = "zenoh/subscribers.rs"]
mod subscribers;
mod tap;
mod variables;

use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use program::{Error, Running, start};
use serde_json::{Value, json};
use subscribers::{Seen, now_ms};
use variables::number;
use zenoh::Wait as _;
use zenoh::qos::{CongestionControl, Priority};

/// Telemetry rate of the gateway.
const HZ: u64 = 50;

/// Speed of the fingers: the stroke takes 20 s.
const SLOW_MM_S: f64 = 5.0;

/// Payload size of the flood, similar to a state.
const FLOOD_BYTES: usize = 700;

/// Returns a port that is free at the moment.
fn free() -> Result<String, Error> {
    Ok(std::net::TcpListener::bind("127.0.0.1:0")?.local_addr()?.to_string())
}

/// Zenoh configuration without scouting or automatic connections.
fn config(mode: &str, listen: &[&str], connect: &[&str]) -> Result<zenoh::Config, Error> {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", json!(mode)),
        ("listen/endpoints", json!(listen)),
        ("connect/endpoints", json!(connect)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/autoconnect", json!({"router": [], "peer": [], "client": []})),
    ] {
        config.insert_json5(key, &value.to_string())?;
    }
    Ok(config)
}

/// Publishes telemetry at the gateway's rate, without the gateway.
fn publish(endpoint: &str) -> Result<(), Error> {
    let session = zenoh::open(config("peer", &[endpoint], &[])?).wait()?;
    let publisher = session.declare_publisher("wsg/v1/bare/g/telemetry").priority(Priority::DataLow).wait()?;
    println!("publishing");
    for seq in 0_u64.. {
        let at = jiff::Timestamp::from_millisecond(now_ms())?;
        let body = json!({"gripper": "g", "seq": seq, "at": at, "width_mm": null, "speed_mm_s": 0.0, "force_n": 0.0,
            "state": "IDLE", "flags_raw": 262_144});
        publisher.put(body.to_string()).wait()?;
        std::thread::sleep(Duration::from_secs(1) / HZ as u32);
    }
    Ok(())
}

/// Measures rate and delay.
fn measure(name: &str, seen: &Arc<Seen>, subscribers: usize) -> (f64, f64) {
    std::thread::sleep(Duration::from_secs(1));
    seen.begin();
    let begun = Instant::now();
    std::thread::sleep(Duration::from_secs(number("SECONDS", 5) as u64));
    let (count, mean_ms, p99_ms) = seen.end();
    let rate = count as f64 / begun.elapsed().as_secs_f64() / subscribers as f64;
    println!("{name}: {rate:.1} messages/s to each of {subscribers}, mean delay {mean_ms:.2} ms, p99 {p99_ms} ms");
    (rate, mean_ms)
}

/// A client that stops the gripper with a put, and acknowledges.
struct Stopper {
    session: zenoh::Session,
    stops: Receiver<Instant>,
}

impl Stopper {
    fn ask(&self, what: &str, payload: &Value) -> Result<Value, Error> {
        let replies = self.session.get(format!("wsg/v1/gateway/g/{what}")).payload(payload.to_string()).wait()?;
        let reply = replies.recv()?.into_result().map_err(|error| format!("{:?}", error.payload()))?;
        Ok(serde_json::from_slice(&reply.payload().to_bytes())?)
    }

    /// Returns the first state for which `condition` holds.
    fn until(&self, condition: impl Fn(&Value) -> bool) -> Result<Value, Error> {
        loop {
            let state = self.ask("state", &json!({}))?;
            if condition(&state) {
                return Ok(state);
            }
        }
    }

    /// Begins a motion that lasts longer than a measurement, so that the gripper sends updates at the full rate.
    fn begin_motion(&self) -> Result<(), Error> {
        let at_rest = self.until(|state| state["moving"] == false)?;
        let width_mm = if at_rest["width_mm"].as_f64().ok_or("no width")? > 55.0 { 5.0 } else { 105.0 };
        self.ask("command/move", &json!({"width_mm": width_mm, "speed_mm_s": SLOW_MM_S}))?;
        self.until(|state| state["moving"] == true).map(drop)
    }

    /// Returns the time from the put until the device has the frame.
    fn stop(&self) -> Result<Duration, Error> {
        while self.stops.try_recv().is_ok() {}
        let begun = Instant::now();
        let put = self.session.put("wsg/v1/fast-stop", "a bench").priority(Priority::RealTime).express(true);
        put.congestion_control(CongestionControl::Block).wait()?;
        let reached = self.stops.recv_timeout(Duration::from_secs(20)).map_err(|_| "no FAST STOP within 20 s")?;
        let stopped = self.until(|state| state["fast_stop_confirmed"] == true)?;
        self.ask("command/acknowledge", &json!({"fast_stop_id": stopped["fast_stop_id"]}))?;
        Ok(reached - begun)
    }

    fn stops(&self, count: usize) -> Result<Vec<Duration>, Error> {
        let mut times = (0..count).map(|_| self.stop()).collect::<Result<Vec<_>, _>>()?;
        times.sort_unstable();
        Ok(times)
    }
}

fn percentile(times: &[Duration], percent: usize) -> Duration {
    times[(times.len() - 1) * percent / 100]
}

fn main() -> Result<(), Error> {
    if let Ok(endpoint) = std::env::var("PUBLISH_AT") {
        return publish(&endpoint);
    }
    let subscribers = number("SUBSCRIBERS", 20);
    let (_device, device) = start(&["sim", "tcp://127.0.0.1:0"], " at tcp://")?;
    let (tapped, stops) = tap::start(device)?;
    let (gripper, http) = (format!("g=tcp://{tapped}"), free()?);
    let arguments = ["--listen", &http, "--zenoh-listen", "tcp/127.0.0.1:0", "--gripper", &gripper];
    let (_gateway, endpoint) = start(&arguments, "Zenoh: ")?;

    let stopper = Stopper { session: zenoh::open(config("client", &[], &[&endpoint])?).wait()?, stops };
    stopper.until(|state| state["link"] == "connected")?;
    stopper.ask("command/home", &json!({}))?;
    stopper.until(|state| state["referenced"] == true)?;

    stopper.begin_motion()?;
    let by_zenoh = subscribers::zenoh(subscribers, &endpoint, "wsg/v1/gateway/g/telemetry")?;
    let zenoh = measure("Zenoh", &by_zenoh.0, subscribers);
    drop(by_zenoh);
    stopper.begin_motion()?;
    let by_websocket = subscribers::websocket(subscribers, &http)?;
    let websocket = measure("WebSocket", &by_websocket.0, subscribers);
    drop(by_websocket);
    let bare_endpoint = format!("tcp/{}", free()?);
    let mut command = Command::new(std::env::current_exe()?);
    let publisher = Running(command.env("PUBLISH_AT", &bare_endpoint).stdout(Stdio::null()).spawn()?);
    let by_bare = subscribers::zenoh(subscribers, &bare_endpoint, "wsg/v1/bare/g/telemetry")?;
    let bare = measure("bare Zenoh", &by_bare.0, subscribers);
    drop((by_bare, publisher));
    for (name, (rate, late)) in [("Zenoh", zenoh), ("WebSocket", websocket)] {
        println!("{name} to bare Zenoh: rate {:.2}, delay {:.2}", rate / bare.0, late / bare.1);
    }

    let crowd = subscribers::zenoh(subscribers, &endpoint, "wsg/v1/**")?;
    stopper.stops(10)?;
    let count = number("STOPS", 100);
    let idle = stopper.stops(count)?;
    let (floods, put) = (Arc::new(AtomicBool::new(true)), Arc::new(AtomicU64::new(0)));
    let flood = {
        let (session, floods, put) =
            (zenoh::open(config("client", &[], &[&endpoint])?).wait()?, floods.clone(), put.clone());
        std::thread::spawn(move || {
            while floods.load(Ordering::Relaxed) {
                let telemetry =
                    session.put("wsg/v1/flood/g/state", vec![b' '; FLOOD_BYTES]).priority(Priority::DataLow);
                let _ = telemetry.congestion_control(CongestionControl::Drop).wait();
                put.fetch_add(1, Ordering::Relaxed);
            }
        })
    };
    let begun = Instant::now();
    let loaded = stopper.stops(count)?;
    let rate = put.load(Ordering::Relaxed) as f64 / begun.elapsed().as_secs_f64();
    floods.store(false, Ordering::Relaxed);
    let _ = flood.join();
    println!("FAST STOP put, with {subscribers} subscribers of all keys, and a client that puts {rate:.0} states/s:");
    for (name, percent) in [("p50", 50), ("p99", 99)] {
        let (idle, loaded) = (percentile(&idle, percent), percentile(&loaded, percent));
        let ratio = loaded.as_secs_f64() / idle.as_secs_f64();
        println!("to the device, {name} of {count}: without {idle:?}, with {loaded:?}, ratio {ratio:.2}");
    }
    drop(crowd);
    Ok(())
}
