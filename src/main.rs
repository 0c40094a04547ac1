//! The `wsg-gateway` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    match wsg_gateway::cli::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("wsg-gateway: {error:#}");
            ExitCode::FAILURE
        }
    }
}
