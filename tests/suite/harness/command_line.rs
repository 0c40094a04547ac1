//! Commands that print something and exit.

use super::process::{Ended, Process};

/// Runs the binary with these arguments until it exits.
pub async fn run(arguments: &[&str]) -> Ended {
    Process::start(arguments).ended().await
}
