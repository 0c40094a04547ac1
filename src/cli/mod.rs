//! The command line: subcommands and flags.

mod backup;
mod decode;
mod discover;
mod doctor;
mod init;
mod journal;
mod package;
mod reload;
mod token;
mod version;

use std::fs::File;
use std::io::{BufReader, Write};
use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::{Context, ensure};
use clap::{CommandFactory as _, Parser, Subcommand};
use url::Url;

use crate::config::{Config, Flags};
use crate::logging::{self, LogFormat};
use crate::transport::host::parse_web_url;
use crate::{daemon, interfaces};

/// Lets many clients share Weiss/SCHUNK WSG grippers. Without a subcommand, serves the configured grippers, or two
/// simulated ones if none is configured.
#[derive(Debug, Parser)]
#[command(name = "wsg-gateway", version, long_version = version::long(), args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(flatten)]
    flags: Flags,
    /// Format of the log
    #[arg(long, value_name = "FORMAT", env = "WSG_GATEWAY_LOG_FORMAT", global = true, value_enum, default_value_t)]
    log_format: LogFormat,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve a simulated gripper on each URL, e.g. tcp://127.0.0.1:1000
    Sim {
        /// Addresses to serve: tcp://127.0.0.1:1000, udp://127.0.0.1:1500?reply_port=1501,
        /// serial://pty?baud=115200&link=/tmp/gripper, can://vcan0?rx=0x64&tx=0x65. Options of one gripper can follow, e.g.
        /// tcp://127.0.0.1:1000?part_mm=20
        #[arg(required = true, value_name = "URL")]
        urls: Vec<Url>,
        /// Gripper model: wsg25, wsg32, wsg50 or wsg70
        #[arg(long, default_value = "wsg50")]
        model: String,
        /// Width in mm of a part within reach of the fingers
        #[arg(long, value_name = "MM")]
        part_mm: Option<String>,
        /// Firmware generation: fw2 or fw4
        #[arg(long, default_value = "fw4")]
        firmware: String,
        /// Further option of the simulated gripper, as in the query of a sim:// URL, e.g. finger1=fmf or
        /// script=B0:measurement (repeatable)
        #[arg(long, value_name = "OPTION=VALUE")]
        option: Vec<String>,
        /// Address to serve HTTP on for injecting faults: GET /devices lists the devices; POST /devices/0 takes an
        /// event, e.g. {"place_part": {"width_mm": 20}}, "take_part", "slip_part", {"overheat": {"temperature_c": 90}},
        /// "cool", {"silent": {"on": true}}, "cut_connection", {"reboot": {"ready_after_ms": 500}}
        #[arg(long, value_name = "ADDR")]
        control: Option<SocketAddr>,
    },
    /// Check a configuration and print what it would serve
    Check {
        #[command(flatten)]
        flags: Flags,
    },
    /// Check this installation: configuration, permissions, ports, journal, disk, clock and grippers. Prints what is
    /// wrong with the remedy, and exits with 1 if there is a problem
    Doctor(doctor::DoctorArgs),
    /// Find grippers in networks, on serial ports and on CAN interfaces. Asks before it contacts them
    Discover(discover::DiscoverArgs),
    /// Print the OpenAPI document
    Openapi,
    /// Print the AsyncAPI document of the WebSocket interface
    Asyncapi,
    /// Decode hex into readable frames, one per line, or encode a frame
    Decode {
        /// File with lines of hex, each optionally preceded by a time and -> or <-; lines that begin with # are
        /// comments [default: standard input]
        #[arg(value_name = "FILE", conflicts_with = "encode")]
        file: Option<PathBuf>,
        /// Print the bytes of a frame, e.g. 'Grip width=20 speed=50', FastStop or '0xB0 0x20 150.0f "text"'
        #[arg(long, value_name = "TEXT")]
        encode: Option<String>,
        /// Print frames live from a running gateway, e.g. http://127.0.0.1:8080 for all grippers, or
        /// http://127.0.0.1:8080/api/v1/grippers/left for one
        #[arg(long, value_name = "URL", value_parser = parse_web_url, conflicts_with_all = ["file", "encode"])]
        follow: Option<Url>,
    },
    /// Save everything that a gateway needs in one file: configuration, tokens, certificates, recipes, finger sets and
    /// journal. A running gateway is not disturbed
    Backup(backup::BackupArgs),
    /// Write the files of a backup to their places
    Restore(backup::RestoreArgs),
    /// List, follow, export, verify or back up the journal, even while the gateway runs
    Journal(journal::JournalArgs),
    /// Write man pages and shell completions below a directory
    #[command(hide = true)]
    PackageFiles {
        #[arg(value_name = "DIRECTORY")]
        directory: PathBuf,
    },
    /// Make a running gateway read its configuration again, and print the changes
    Reload(reload::ReloadArgs),
    /// Create, list or revoke the tokens of clients
    Token(token::TokenArgs),
    /// Write a configuration with TLS and a first token, for a gateway on a network
    Init(init::InitArgs),
    /// Write a self-signed certificate and its key
    Certificate(init::CertificateArgs),
}

/// Runs the subcommand that the process arguments name.
///
/// # Errors
/// The cause of the failure, and the remedy.
pub fn run() -> anyhow::Result<()> {
    let cli = Cli::parse();
    let _logs = logging::init(cli.log_format);
    match cli.command {
        None => daemon::run(&cli.flags),
        Some(Command::Sim { urls, model, part_mm, firmware, option, control }) => {
            let mut device = daemon::SimulatedDevice::of_model(&model).map_err(anyhow::Error::msg)?;
            device = device.with("firmware", &firmware).map_err(anyhow::Error::msg)?;
            if let Some(part_mm) = part_mm {
                device = device.with("part_mm", &part_mm).map_err(anyhow::Error::msg)?;
            }
            for option in option {
                let (name, value) = option.split_once('=').unwrap_or((&option, ""));
                device = device.with(name, value).map_err(anyhow::Error::msg)?;
            }
            daemon::run_simulated(&urls, &device, control)
        }
        Some(Command::Check { flags }) => check(&flags),
        Some(Command::Doctor(arguments)) => doctor::run(&arguments),
        Some(Command::Discover(arguments)) => discover::run(&arguments),
        Some(Command::Openapi) => quietly(write!(std::io::stdout(), "{}", interfaces::http::OPENAPI)),
        Some(Command::Asyncapi) => quietly(write!(std::io::stdout(), "{}", interfaces::http::ASYNCAPI)),
        Some(Command::Decode { encode: Some(text), .. }) => {
            let frame = decode::encode(&text)?;
            quietly(writeln!(std::io::stdout(), "{frame}"))
        }
        Some(Command::Decode { follow: Some(url), .. }) => {
            let mut output = std::io::stdout();
            let followed = daemon::runtime()?.block_on(decode::follow(&url, &mut output));
            followed.or_else(|error| quietly(Err(error.downcast::<std::io::Error>()?)))
        }
        Some(Command::Decode { file, encode: None, follow: None }) => {
            let mut output = std::io::stdout().lock();
            let wrong = quietly(match file {
                Some(path) => {
                    let file = File::open(&path).with_context(|| path.display().to_string())?;
                    decode::decode(BufReader::new(file), &mut output)
                }
                None => decode::decode(std::io::stdin().lock(), &mut output),
            })?;
            ensure!(wrong == 0, "lines that could not be decoded: {wrong} (each is marked in the output)");
            Ok(())
        }
        Some(Command::Backup(arguments)) => backup::back_up_all(&arguments, std::io::stdout().lock()),
        Some(Command::Restore(arguments)) => backup::restore(&arguments, std::io::stdout().lock()),
        Some(Command::Journal(journal)) => journal::run(&journal, std::io::stdout().lock()),
        Some(Command::PackageFiles { directory }) => package::write(&directory, Cli::command()),
        Some(Command::Reload(args)) => {
            let changes = daemon::runtime()?.block_on(reload::reload(&args))?;
            quietly(writeln!(std::io::stdout(), "{}", reload::described(&changes)))
        }
        Some(Command::Token(args)) => token::run(&args, std::io::stdout().lock()),
        Some(Command::Init(args)) => init::run(&args, std::io::stdout().lock()),
        Some(Command::Certificate(args)) => init::certificate(&args, std::io::stdout().lock()),
    }
}

fn check(flags: &Flags) -> anyhow::Result<()> {
    let config = Config::load(flags)?;
    daemon::check(&config)?;
    daemon::check_files(&config)?;
    daemon::runtime()?.block_on(daemon::check_devices(&config))?;
    for warning in &config.warnings {
        let _ = writeln!(std::io::stderr(), "warning: {warning}");
    }
    quietly(writeln!(std::io::stdout(), "configuration valid: {}", config.summary()))
}

/// Ignores a broken pipe: the reader of standard output may stop early.
fn quietly<T: Default>(written: std::io::Result<T>) -> anyhow::Result<T> {
    match written {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(T::default()),
        written => Ok(written?),
    }
}
