//! `wsg-gateway discover`: finds grippers, and prints the flag that serves each.

use std::io::{BufRead as _, IsTerminal as _, Write as _};

use anyhow::{bail, ensure};
use clap::Args;
use ipnet::IpNet;

use crate::daemon;
use crate::doctor::discover::SearchPlan;
use crate::transport::host::check_network;

/// TCP port that devices listen on (field practice).
const DEVICE_PORT: u16 = 1000;

#[derive(Debug, Args)]
pub(super) struct DiscoverArgs {
    /// Network to search, e.g. 192.168.1.0/24 (repeatable)
    #[arg(long = "subnet", value_name = "NETWORK", value_parser = parse_subnet)]
    subnets: Vec<IpNet>,
    /// TCP port of the grippers
    #[arg(long, value_name = "PORT", default_value_t = DEVICE_PORT)]
    port: u16,
    /// Search the given networks only, not the serial ports and CAN interfaces
    #[arg(long)]
    network_only: bool,
    /// Contact the devices without asking
    #[arg(long)]
    yes: bool,
}

fn parse_subnet(text: &str) -> anyhow::Result<IpNet> {
    let network = text.parse()?;
    check_network(text)?;
    Ok(network)
}

pub(super) fn run(arguments: &DiscoverArgs) -> anyhow::Result<()> {
    let plan = SearchPlan::new(&arguments.subnets, arguments.port, !arguments.network_only)?;
    ensure!(!plan.is_empty(), "nothing to search: name a network, e.g. --subnet 192.168.1.0/24");
    if !arguments.yes && !is_allowed(&plan)? {
        return Ok(());
    }
    let mut found = 0_u32;
    daemon::runtime()?.block_on(plan.run(|discovered| {
        found += u32::from(discovered.is_device);
        let sign = if discovered.is_device { "gripper" } else { "-" };
        let _ = writeln!(std::io::stdout(), "{sign:<8} {:<40} {}", discovered.address.to_string(), discovered.text);
    }));
    let _ = writeln!(std::io::stdout(), "grippers found: {found}");
    Ok(())
}

/// Asks on the terminal. A device accepts one client, so contact can disturb another program.
fn is_allowed(plan: &SearchPlan) -> anyhow::Result<bool> {
    let warning = "A device that another program uses can drop that program's connection, and devices other than \
                   grippers receive a frame that they do not know.";
    if !std::io::stdin().is_terminal() {
        bail!("this would contact {}. {warning} Pass --yes to go on", plan.describe());
    }
    let mut out = std::io::stdout();
    write!(out, "This contacts {}. {warning}\nGo on? [y/N] ", plan.describe())?;
    out.flush()?;
    let mut answer = String::new();
    std::io::stdin().lock().read_line(&mut answer)?;
    Ok(["y", "yes"].contains(&answer.trim().to_lowercase().as_str()))
}
