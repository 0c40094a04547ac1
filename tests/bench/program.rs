//! Processes of the gateway, as started by the benches.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

pub type Error = Box<dyn std::error::Error + Send + Sync>;

/// A process that is killed with the bench.
pub struct Running(pub Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Environment variable with the path of another build of the gateway. To compare two builds, run a bench with each.
const PROGRAM: &str = "WSG_GATEWAY_PROGRAM";

/// Starts the program, and returns the output between `before` and the end of its line. Only errors are logged, so that
/// logging is not measured.
pub fn start(arguments: &[&str], before: &str) -> Result<(Running, String), Error> {
    let (running, mut found) = start_all(arguments, before, 1)?;
    Ok((running, found.remove(0)))
}

/// Like [`start`], for the first `count` such lines.
pub fn start_all(arguments: &[&str], before: &str, count: usize) -> Result<(Running, Vec<String>), Error> {
    let program = std::env::var(PROGRAM).unwrap_or_else(|_| env!("CARGO_BIN_EXE_wsg-gateway").to_owned());
    let mut command = Command::new(program);
    command.env("WSG_GATEWAY_JOURNAL", ":memory:").env("WSG_GATEWAY_LOG", "error");
    let mut child = command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn()?;
    let lines = BufReader::new(child.stdout.take().ok_or("no output")?).lines();
    let running = Running(child);
    let mut found = Vec::new();
    for line in lines {
        if let Some((_, rest)) = line?.split_once(before) {
            found.push(rest.trim_end_matches('/').to_owned());
        }
        if found.len() == count {
            return Ok((running, found));
        }
    }
    Err(format!("{} of {count} lines with {before:?}", found.len()).into())
}
