//! Memory and processor time of a process.

use crate::program::{Error, Running};

/// Kernel clock ticks per second.
const TICKS: f64 = 100.0;

impl Running {
    /// Resident memory, in MiB.
    pub fn memory(&self) -> Result<f64, Error> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.0.id()))?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).ok_or("no VmRSS")?;
        Ok(line.trim().trim_end_matches(" kB").parse::<f64>()? / 1024.0)
    }

    /// Processor time used, in seconds.
    pub fn time(&self) -> Result<f64, Error> {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.0.id()))?;
        let fields: Vec<_> = stat.rsplit(')').next().ok_or("no stat")?.split_whitespace().collect();
        let ticks = |index: usize| fields.get(index).ok_or("too short").map(|field| field.parse::<f64>());
        Ok((ticks(11)?? + ticks(12)??) / TICKS)
    }
}
