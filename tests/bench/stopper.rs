//! A client that stops a moving gripper, and acknowledges.

use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::runtime::{Builder, Runtime};

use crate::program::Error;

/// Time for which the fingers move before they are stopped, so that observers get updates at the full rate.
const MOVES_FOR: Duration = Duration::from_millis(100);

/// Speed at which the fingers move for longer than a fan-out.
const SLOW_MM_S: f64 = 5.0;

/// Limit of a wait for a state.
const WAITS_FOR: Duration = Duration::from_secs(10);

pub struct Stopper {
    pub runtime: Runtime,
    http: reqwest::Client,
    /// URL of the gripper `g`.
    base: String,
    /// Times at which the device got a FAST STOP frame.
    stops: Receiver<Instant>,
}

impl Stopper {
    /// Waits for the gripper's link, and homes the gripper.
    pub fn new(address: &str, stops: Receiver<Instant>) -> Result<Self, Error> {
        let runtime = Builder::new_current_thread().enable_all().build()?;
        // The gateway closes an idle connection after 10 s.
        let http = reqwest::Client::builder().pool_idle_timeout(Duration::from_secs(1)).build()?;
        let stopper = Self { runtime, http, base: format!("http://{address}/api/v1/grippers/g"), stops };
        stopper.until("the gripper is connected", |state| state["link"] == "connected")?;
        stopper.post("home", &json!({}))?;
        Ok(stopper)
    }

    fn post(&self, path: &str, body: &Value) -> Result<Value, Error> {
        let url = format!("{}/{path}", self.base);
        Ok(self.runtime.block_on(async { self.http.post(url).json(body).send().await?.json().await })?)
    }

    fn state(&self) -> Result<Value, Error> {
        let url = format!("{}/state", self.base);
        Ok(self.runtime.block_on(async { self.http.get(url).send().await?.json().await })?)
    }

    /// Returns the first state for which `condition` holds.
    fn until(&self, what: &str, condition: impl Fn(&Value) -> bool) -> Result<Value, Error> {
        let deadline = Instant::now() + WAITS_FOR;
        while Instant::now() < deadline {
            let state = self.state()?;
            if condition(&state) {
                return Ok(state);
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Err(format!("not in time: {what}").into())
    }

    /// Begins a slow motion towards the farther end, unless one is still running.
    pub fn begin_motion(&self) -> Result<(), Error> {
        let width_mm = if self.state()?["width_mm"].as_f64().ok_or("no width")? > 55.0 { 5.0 } else { 105.0 };
        let begun = self.post("move?wait_ms=0", &json!({"width_mm": width_mm, "speed_mm_s": SLOW_MM_S}))?;
        if begun["phase"] == "running" || begun["code"] == "already_running" {
            Ok(())
        } else {
            Err(format!("not moving: {begun}").into())
        }
    }

    /// Stops a motion by `request`. Returns the time from the request until the device has the frame.
    pub fn stop_by(&self, request: impl FnOnce() -> Result<(), Error>) -> Result<Duration, Error> {
        self.begin_motion()?;
        std::thread::sleep(MOVES_FOR);
        while self.stops.try_recv().is_ok() {}
        let begun = Instant::now();
        request()?;
        let reached = self.stops.recv_timeout(Duration::from_secs(5))?;
        let stopped = self.until("the FAST STOP is confirmed", |state| state["fast_stop_confirmed"] == true)?;
        let acknowledged = self.post("acknowledge", &json!({"fast_stop_id": stopped["fast_stop_id"]}))?;
        if acknowledged["fast_stop"] != false {
            return Err(format!("not acknowledged: {acknowledged}").into());
        }
        Ok(reached - begun)
    }

    /// Stops a motion by HTTP.
    pub fn stop(&self) -> Result<Duration, Error> {
        self.stop_by(|| self.post("fast-stop", &json!({"reason": "a bench"})).map(drop))
    }
}

/// Returns a percentile of sorted times.
pub fn percentile(times: &[Duration], percent: usize) -> Duration {
    times[(times.len() - 1) * percent / 100]
}
