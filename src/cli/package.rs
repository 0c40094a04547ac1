//! Files that packages contain: man pages and shell completions of this command line.

use std::fs;
use std::path::Path;

use anyhow::Context;
use clap::Command;
use clap_complete::{Shell, generate_to};

/// Shells with completions.
const SHELLS: [Shell; 3] = [Shell::Bash, Shell::Fish, Shell::Zsh];

/// Writes `man/*.1` and `completions/*` below a directory.
pub(super) fn write(directory: &Path, mut command: Command) -> anyhow::Result<()> {
    let man = directory.join("man");
    let completions = directory.join("completions");
    for created in [&man, &completions] {
        fs::create_dir_all(created).with_context(|| format!("{} cannot be created", created.display()))?;
    }
    // `help` has no flags of its own.
    command = command.disable_help_subcommand(true).mut_subcommands(|command| command.disable_help_subcommand(true));
    let name = command.get_name().to_owned();
    for shell in SHELLS {
        generate_to(shell, &mut command, &name, &completions)?;
    }
    Ok(clap_mangen::generate_to(command, &man)?)
}
