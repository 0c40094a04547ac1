//! `wsg-gateway token`: creates, lists and revokes tokens.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::{Args, Subcommand};
use jiff::{Span, Timestamp, Zoned};
use strum::VariantArray as _;

use crate::access::{NewToken, Role, StoredToken, TokenFile};
use crate::config::{AccessConfig, Config, Flags};
use crate::model::Name;

/// Default lifetime of a token.
const DEFAULT_EXPIRY: &str = "90d";

#[derive(Debug, Args)]
pub(super) struct TokenArgs {
    /// File of tokens [default: the one that the --config file names]
    #[arg(long, value_name = "FILE", env = "WSG_GATEWAY_TOKENS", global = true)]
    tokens: Option<PathBuf>,
    /// Configuration file of the gateway
    #[arg(long, value_name = "FILE", env = "WSG_GATEWAY_CONFIG", global = true)]
    config: Option<PathBuf>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Create a token and print it, once
    Create {
        /// Name of the client, for the journal and for revoking the token
        #[arg(long)]
        name: Name,
        /// stop, observer, operator or supervisor
        #[arg(long, value_parser = role)]
        role: Role,
        /// A gripper that the token is for (repeatable) [default: all grippers]
        #[arg(long = "gripper", value_name = "NAME")]
        grippers: Vec<Name>,
        /// Lifetime, e.g. 90d, 12h or never [default: 90d]. A machine's token that must not end needs never
        #[arg(long, value_name = "TIME")]
        expires: Option<String>,
        /// Create a PIN of six digits instead, which gives a signed-in panel this name, role and grippers
        #[arg(long)]
        pin: bool,
    },
    /// List all tokens, without their secrets
    List,
    /// Revoke a token; a running gateway refuses it at once
    Revoke {
        #[arg(value_name = "NAME")]
        name: Name,
    },
}

pub(super) fn run(args: &TokenArgs, mut output: impl Write) -> anyhow::Result<()> {
    let (file, config) = file(args)?;
    if let Command::Create { grippers, .. } = &args.command
        && args.config.is_some()
    {
        for gripper in grippers {
            if let Some(warning) = unknown(gripper, &config) {
                let _ = writeln!(std::io::stderr(), "warning: {warning}");
            }
        }
    }
    match &args.command {
        Command::Create { name, role, grippers, expires, pin } => {
            let expires_at = expiry(expires.as_deref().unwrap_or(DEFAULT_EXPIRY))?;
            let grippers: BTreeSet<_> = grippers.iter().cloned().collect();
            let new = new_token(name.clone(), *role, grippers, expires_at);
            let secret = if *pin {
                file.create_pin(Timestamp::now(), new)?.expose().to_owned()
            } else {
                file.create(Timestamp::now(), new)?.expose().to_owned()
            };
            writeln!(output, "{secret}")?;
            // Standard output has the secret alone, because scripts store it.
            let _ = writeln!(std::io::stderr(), "{}", expiry_notice(name, expires_at, expires.is_some(), *pin));
            Ok(())
        }
        Command::List => {
            for token in file.list()? {
                writeln!(output, "{}", line(&token))?;
            }
            Ok(())
        }
        Command::Revoke { name } => Ok(file.revoke(name)?),
    }
}

fn role(text: &str) -> Result<Role, String> {
    let roles = Role::VARIANTS.iter().map(Role::to_string).collect::<Vec<_>>().join(", ");
    text.parse().map_err(|_| format!("no role has this name: use one of {roles}"))
}

/// Describes a token for these grippers, or for all if the set is empty.
pub(super) fn new_token(name: Name, role: Role, grippers: BTreeSet<Name>, expires_at: Option<Timestamp>) -> NewToken {
    let grippers = (!grippers.is_empty()).then_some(grippers);
    NewToken { name, role, grippers, expires_at }
}

/// Says when a new token ends, and how to get one that does not if nobody chose a lifetime. A PIN is a person's.
fn expiry_notice(name: &Name, expires_at: Option<Timestamp>, is_chosen: bool, is_pin: bool) -> String {
    let kind = if is_pin { "PIN" } else { "token" };
    match expires_at {
        None => format!("{kind} {name} does not expire"),
        Some(at) if is_chosen || is_pin => format!("{kind} {name} expires on {at:.0}"),
        Some(at) => format!(
            "{kind} {name} expires on {at:.0}, and its client is then refused. For a machine that must not be refused: \
             revoke {name}, and create it again with --expires never"
        ),
    }
}

/// Returns the file of tokens, and the configuration of its gateway.
fn file(args: &TokenArgs) -> anyhow::Result<(TokenFile, Config)> {
    let flags = Flags { tokens: args.tokens.clone(), config: args.config.clone(), ..Flags::default() };
    let config = Config::load(&flags)?;
    let file = match (&args.tokens, &config.access) {
        (Some(tokens), _) => TokenFile::at(tokens.clone()),
        (None, AccessConfig::Guarded(guarded)) => TokenFile::at(guarded.tokens.clone()),
        (None, AccessConfig::Open) => {
            bail!("no file of tokens: name it with --tokens, or name a --config file with an [access] table")
        }
    };
    Ok((file, config))
}

/// Returns a warning if this gateway has no such gripper. The token may be meant for another gateway.
fn unknown(gripper: &Name, config: &Config) -> Option<String> {
    let names: Vec<_> = config.grippers.iter().map(|gripper| gripper.name.as_str()).collect();
    let is_known = names.contains(&gripper.as_str());
    (!is_known).then(|| format!("no gripper is named {gripper}: this gateway has {}", names.join(", ")))
}

/// Parses a lifetime. `never` has no end.
fn expiry(text: &str) -> anyhow::Result<Option<Timestamp>> {
    if text == "never" {
        return Ok(None);
    }
    let span: Span = text.parse().with_context(|| not_a_time(text))?;
    let end = Zoned::now().checked_add(span).with_context(|| not_a_time(text))?.timestamp();
    if end <= Timestamp::now() {
        bail!("--expires {text:?} is in the past: write 90d, 12h or never");
    }
    Ok(Some(end))
}

fn not_a_time(text: &str) -> String {
    format!("--expires {text:?} is not a time: write 90d, 12h or never")
}

fn line(token: &StoredToken) -> String {
    let StoredToken { name, role, grippers, created_at, expires_at, is_pin, .. } = token;
    let grippers = grippers.as_ref().map_or_else(
        || "all grippers".to_owned(),
        |grippers| grippers.iter().map(Name::as_str).collect::<Vec<_>>().join(","),
    );
    let expiry = match expires_at {
        None => "never expires".to_owned(),
        Some(at) if *at <= Timestamp::now() => format!("expired {at:.0}"),
        Some(at) => format!("expires {at:.0}"),
    };
    let kind = if *is_pin { "  PIN" } else { "" };
    format!("{name}  {role}{kind}  {grippers}  created {created_at:.0}  {expiry}")
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::access::TokenSecret;

    #[derive(Parser)]
    struct Parsed {
        #[command(flatten)]
        args: TokenArgs,
    }

    fn said(tokens: &std::path::Path, arguments: &[&str]) -> anyhow::Result<String> {
        let all = ["token", "--tokens", tokens.to_str().unwrap()].into_iter().chain(arguments.iter().copied());
        let mut output = Vec::new();
        run(&Parsed::try_parse_from(all)?.args, &mut output)?;
        Ok(String::from_utf8(output)?)
    }

    #[test]
    fn token_is_created_listed_and_revoked() {
        let directory = std::env::temp_dir().join(format!("wsg-token-command-{}", std::process::id()));
        let tokens = directory.join("tokens.json");
        let create = ["create", "--name", "plc7", "--role", "operator", "--gripper", "left", "--expires", "12h"];
        assert!(said(&tokens, &create).unwrap().trim().parse::<TokenSecret>().is_ok());
        let listed = said(&tokens, &["list"]).unwrap();
        assert!(listed.starts_with("plc7  operator  left  created ") && !listed.contains("wsg_"), "{listed}");
        said(&tokens, &["revoke", "plc7"]).unwrap();
        assert_eq!(said(&tokens, &["list"]).unwrap(), "");
        std::fs::remove_dir_all(directory).unwrap();
    }

    #[test]
    fn wrong_role_and_unknown_gripper_are_named() {
        let error = said(std::path::Path::new("none"), &["create", "--name", "plc7", "--role", "admin"]).unwrap_err();
        assert!(error.to_string().contains("use one of stop, observer, operator, supervisor"), "{error}");
        let config = Config::load(&Flags::default()).unwrap();
        let unknown = |name: &str| unknown(&name.parse().unwrap(), &config);
        assert_eq!(unknown("left"), None);
        assert_eq!(unknown("lefft").unwrap(), "no gripper is named lefft: this gateway has left, right");
    }

    #[test]
    fn end_of_a_new_token_is_said_and_how_to_avoid_it() {
        let name = "plc7".parse().unwrap();
        let at = Some("2027-02-27T12:00:00Z".parse().unwrap());
        let unasked = expiry_notice(&name, at, false, false);
        assert!(unasked.starts_with("token plc7 expires on 2027-02-27T12:00:00Z, and its client"), "{unasked}");
        assert!(unasked.ends_with("revoke plc7, and create it again with --expires never"), "{unasked}");
        assert_eq!(expiry_notice(&name, at, true, false), "token plc7 expires on 2027-02-27T12:00:00Z");
        assert_eq!(expiry_notice(&name, at, false, true), "PIN plc7 expires on 2027-02-27T12:00:00Z");
        assert_eq!(expiry_notice(&name, None, true, false), "token plc7 does not expire");
    }

    #[test]
    fn lifetime_is_checked() {
        assert_eq!(expiry("never").unwrap(), None);
        let hours = expiry("12h").unwrap().unwrap().duration_since(Timestamp::now()).as_secs_f64() / 3600.0;
        assert!((11.9..12.1).contains(&hours), "{hours}");
        for wrong in ["", "90", "soon", "-1d", "0s", "99999999y"] {
            assert!(expiry(wrong).unwrap_err().to_string().contains("write 90d"), "{wrong}");
        }
    }
}
