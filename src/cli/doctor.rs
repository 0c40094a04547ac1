//! `wsg-gateway doctor`: prints what is wrong with an installation, and the remedies.

use std::io::Write as _;
use std::path::PathBuf;

use anyhow::bail;
use clap::Args;

use super::version;
use crate::config::Flags;
use crate::daemon;
use crate::doctor::{Severity, examine, write_bundle};

#[derive(Debug, Args)]
pub(super) struct DoctorArgs {
    #[command(flatten)]
    flags: Flags,
    /// Also write an archive (tar.gz) for a support request: the findings, the configuration without secrets, and the
    /// newest events and log lines
    #[arg(long, value_name = "FILE")]
    bundle: Option<PathBuf>,
}

pub(super) fn run(arguments: &DoctorArgs) -> anyhow::Result<()> {
    let runtime = daemon::runtime()?;
    let mut findings = Vec::new();
    runtime.block_on(examine(&arguments.flags, |finding| {
        // Nobody may be reading.
        let _ = writeln!(std::io::stdout(), "{finding}");
        findings.push(finding.clone());
    }));
    if let Some(path) = &arguments.bundle {
        runtime.block_on(write_bundle(path, &arguments.flags, &findings, &version::long()))?;
        let _ = writeln!(std::io::stdout(), "archive written: {}", path.display());
    }
    let problems = findings.iter().filter(|finding| finding.severity == Severity::Problem).count();
    match problems {
        0 => Ok(()),
        1 => bail!("1 problem found"),
        count => bail!("{count} problems found"),
    }
}
