//! The `wsg-gateway` command.

use std::process::ExitCode;

/// Returns freed memory to the operating system within seconds. After a flood of requests, glibc keeps most of it.
#[cfg(all(feature = "jemalloc", target_arch = "x86_64"))]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> ExitCode {
    match wsg_gateway::cli::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("wsg-gateway: {error:#}");
            ExitCode::FAILURE
        }
    }
}
