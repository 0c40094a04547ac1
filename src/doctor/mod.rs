//! Diagnosis of an installation, and discovery of devices.
//!
//! The checks change no setting and move no gripper. Devices of a running gateway are not contacted, because a device
//! accepts one client.

mod broker;
mod bundle;
mod can;
mod clients;
mod clock;
mod devices;
pub mod discover;
mod files;
mod ports;
mod probe;
mod running;
mod serial;

use std::fmt;
use std::path::PathBuf;

use crate::config::{Config, ConfigError, Flags};
use crate::daemon;

pub use bundle::write as write_bundle;

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    Good,
    /// Works now, but needs attention.
    Warning,
    /// Keeps the gateway or a gripper from working, or exposes a secret.
    Problem,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Good => "ok",
            Self::Warning => "warning",
            Self::Problem => "PROBLEM",
        })
    }
}

/// Result of one check.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnosis {
    pub severity: Severity,
    /// Name of the check.
    pub check: &'static str,
    /// The problem and its remedy, or the confirmed condition.
    pub text: String,
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:<8} {:<14} {}", self.severity, self.check, self.text)
    }
}

impl Diagnosis {
    fn good(check: &'static str, text: impl fmt::Display) -> Self {
        Self { severity: Severity::Good, check, text: text.to_string() }
    }

    fn warning(check: &'static str, text: impl fmt::Display) -> Self {
        Self { severity: Severity::Warning, check, text: text.to_string() }
    }

    fn problem(check: &'static str, text: impl fmt::Display) -> Self {
        Self { severity: Severity::Problem, check, text: text.to_string() }
    }
}

/// Subject of the checks.
struct Installation {
    config: Config,
    /// The configuration file, if there is one.
    file: Option<PathBuf>,
    running: running::GatewayState,
}

/// Checks of this machine. The devices come last, because they take longest.
const CHECKS: &[fn(&Installation) -> Vec<Diagnosis>] =
    &[running::check, files::user, files::secrets, files::journal, files::disk, clock::check, ports::check];

/// Runs all checks. Calls `report` with each finding as soon as it is known.
pub async fn examine(flags: &Flags, mut report: impl FnMut(&Diagnosis)) {
    let config = match load(flags) {
        Ok(config) => config,
        Err(error) => return report(&Diagnosis::problem("configuration", error)),
    };
    if let Err(error) = daemon::check_devices(&config).await {
        report(&Diagnosis::problem("configuration", error));
    }
    report(&Diagnosis::good("configuration", config.summary()));
    config.warnings.iter().for_each(|warning| report(&Diagnosis::warning("configuration", warning)));
    let running = running::GatewayState::find(&config).await;
    let installation = Installation { config, file: flags.config.clone(), running };
    CHECKS.iter().flat_map(|check| check(&installation)).for_each(|finding| report(&finding));
    if let Some(finding) = broker::check(&installation).await {
        report(&finding);
    }
    devices::check(&installation, report).await;
}

fn load(flags: &Flags) -> Result<Config, ConfigError> {
    let config = Config::load(flags)?;
    daemon::check(&config)?;
    Ok(config)
}

#[cfg(test)]
mod tests;
