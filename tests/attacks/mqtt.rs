//! A broker beside the attacked gateway, through which FAST STOPs and requests come.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::runtime::Runtime;

use crate::broker::{ANSWERS, Broker, Request};
use crate::http::PATIENCE;

const PREFIX: &str = "wsg/gateway";

const LOOK_EVERY: Duration = Duration::from_millis(2);

/// Messages of a flood at a time, and the pause between them: ten thousand in a second.
const FLOOD: usize = 100;
const FLOODS_EVERY: Duration = Duration::from_millis(10);

/// A broker with threads of its own.
#[derive(Debug)]
pub struct Mqtt {
    broker: Arc<Broker>,
    runtime: Runtime,
}

impl Mqtt {
    pub fn start() -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let broker = Arc::new(runtime.block_on(Broker::start()));
        Self { broker, runtime }
    }

    /// Section of the gateway's configuration.
    pub fn section(&self) -> String {
        format!("[mqtt]\nbroker = \"mqtt://{}\"\ncommands = true\nfast_stop = true\n", self.broker.address)
    }

    /// Waits until the gateway has subscribed.
    pub fn until_subscribed(&self) {
        for topic in ["g/fast-stop", "g/command/move"] {
            self.runtime.block_on(self.broker.until_subscribed(&format!("{PREFIX}/{topic}")));
        }
    }

    /// Publishes a FAST STOP of `g` with this correlation data.
    pub fn fast_stop(&self, correlation: &str) {
        let topic = format!("{PREFIX}/g/fast-stop");
        self.broker.send(&Request {
            topic: &topic,
            payload: "the probe",
            correlation: Some(correlation),
            ..Request::default()
        });
    }

    /// Whether the FAST STOP with this correlation data is answered in time.
    pub fn is_answered(&self, correlation: &str) -> bool {
        let until = Instant::now() + PATIENCE;
        while Instant::now() < until {
            let answers = self.broker.all(ANSWERS);
            if answers
                .iter()
                .any(|answer| answer.properties.correlation_data.as_deref() == Some(correlation.as_bytes()))
            {
                return true;
            }
            std::thread::sleep(LOOK_EVERY);
        }
        false
    }

    /// Publishes requests for motions of `h` and for states until the result is dropped.
    pub fn flood(&self) -> Flood {
        let broker = self.broker.clone();
        let is_over = Arc::<AtomicBool>::default();
        let ends = is_over.clone();
        let flooding = std::thread::spawn(move || {
            while !ends.load(Ordering::Relaxed) {
                broker.flood(&format!("{PREFIX}/h/command/move"), "{\"width_mm\": 50, \"speed_mm_s\": 200}", FLOOD / 2);
                broker.flood(&format!("{PREFIX}/h/command/state"), "", FLOOD / 2);
                broker.forget(ANSWERS);
                std::thread::sleep(FLOODS_EVERY);
            }
        });
        Flood { is_over, flooding: Some(flooding) }
    }
}

/// A flood of requests.
#[derive(Debug)]
pub struct Flood {
    is_over: Arc<AtomicBool>,
    flooding: Option<JoinHandle<()>>,
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(flooding) = self.flooding.take() {
            let _ = flooding.join();
        }
    }
}
