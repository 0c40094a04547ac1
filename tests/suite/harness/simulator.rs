//! The simulated device, in a process of its own.

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
    /// One device, with these options besides its URL, e.g. `--part-mm 20`.
    pub async fn start(options: &[&str]) -> Self {
        Self::start_last_of(1, options).await
    }

    /// One with a part of 20 mm in reach.
    pub async fn with_part() -> Self {
        Self::start(&["--part-mm", "20"]).await
    }

    /// One with another serial number than all others have.
    pub async fn with_another_serial_number() -> Self {
        Self::start_last_of(2, &[]).await
    }

    /// Devices of one process are told apart by their serial numbers; this is the last of them.
    async fn start_last_of(devices: usize, options: &[&str]) -> Self {
        let process = Process::start(&[&["sim"], &vec!["tcp://127.0.0.1:0"; devices][..], options].concat());
        let address = eventually("where it listens", async || {
            let said = process.stdout();
            said.split_whitespace().filter_map(|word| word.strip_prefix("tcp://")?.parse().ok()).nth(devices - 1)
        })
        .await;
        Self { process, address }
    }

    /// Sends SIGTERM, and waits for its end.
    pub async fn terminate(mut self) -> Ended {
        self.process.terminate();
        self.process.ended().await
    }

    /// What it said when it started.
    pub fn stdout(&self) -> String {
        self.process.stdout()
    }
}
