//! The simulated device in its own process.

use std::net::SocketAddr;

use super::eventually;
use super::process::{Ended, Process};

/// `wsg-gateway sim`.
#[derive(Debug)]
pub struct Simulator {
    process: Process,
    pub address: SocketAddr,
}

impl Simulator {
    /// Starts one device with these options besides its URL, for example `--part-mm 20`.
    pub async fn start(options: &[&str]) -> Self {
        Self::start_last_of(1, options).await
    }

    /// Starts one device with a control port. Returns the URL to which changes are posted.
    pub async fn with_control() -> (Self, String) {
        let device = Self::start(&["--control", "127.0.0.1:0"]).await;
        let url = eventually("the control port", async || {
            device.stdout().split_whitespace().find(|word| word.starts_with("http://")).map(|url| format!("{url}/0"))
        })
        .await;
        (device, url)
    }

    /// Starts one device with a part of 20 mm in reach.
    pub async fn with_part() -> Self {
        Self::start(&["--part-mm", "20"]).await
    }

    /// Starts one device with a serial number that no other simulator has.
    pub async fn with_another_serial_number() -> Self {
        Self::start_last_of(2, &[]).await
    }

    /// Starts several devices in one process, which differ in serial number, and uses the last.
    async fn start_last_of(devices: usize, options: &[&str]) -> Self {
        let process = Process::start(&[&["sim"], &vec!["tcp://127.0.0.1:0"; devices][..], options].concat());
        let address = eventually("the simulator's address", async || {
            let said = process.stdout();
            said.split_whitespace().filter_map(|word| word.strip_prefix("tcp://")?.parse().ok()).nth(devices - 1)
        })
        .await;
        Self { process, address }
    }

    /// Sends SIGTERM, and waits for the exit.
    pub async fn terminate(mut self) -> Ended {
        self.process.terminate();
        self.process.ended().await
    }

    /// Standard output so far.
    pub fn stdout(&self) -> String {
        self.process.stdout()
    }
}
