//! Commands that say something and end.

use super::process::{Ended, Process};

/// Runs the binary with these arguments to its end.
pub async fn run(arguments: &[&str]) -> Ended {
    Process::start(arguments).ended().await
}
