//! Archive for a support request: the findings, the redacted configuration, and the newest events and log lines.

use std::fs::{self, OpenOptions};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::process::Command;

use anyhow::Context as _;
use flate2::Compression;
use flate2::write::GzEncoder;
use serde_json::Value;
use tar::{Builder, Header};
use url::Url;

use super::{Diagnosis, load, running};
use crate::config::{Config, Flags, JournalLocation};
use crate::journal::{EventQuery, Limit, Reader};

/// Newest events in the archive.
const EVENTS: u64 = 1000;

/// Newest log lines in the archive.
const LOG_LINES: &str = "2000";

/// Words in the names of keys whose values stay out of the archive.
const SECRET_WORDS: [&str; 4] = ["secret", "token", "password", "key"];

/// Members of events that can identify products, wherever they are.
const PRODUCT_MEMBERS: [&str; 2] = ["part_id", "description"];

const REDACTED: &str = "REDACTED";

/// Writes the archive, which only its owner can read.
///
/// # Errors
/// The file that cannot be written, and the reason.
pub async fn write(path: &Path, flags: &Flags, findings: &[Diagnosis], version: &str) -> anyhow::Result<()> {
    let config = load(flags).ok();
    let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
    let file = file.with_context(|| format!("{} cannot be created: name a new file", path.display()))?;
    let mut archive = Builder::new(GzEncoder::new(file, Compression::default()));
    let report = findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
    add(&mut archive, "report.txt", &report)?;
    add(&mut archive, "version.txt", version)?;
    add(&mut archive, "system.txt", &system())?;
    if let Some(text) = flags.config.as_ref().and_then(|path| fs::read_to_string(path).ok()) {
        add(&mut archive, "configuration.toml", &redacted(&text))?;
    }
    if let Some(config) = &config {
        add(&mut archive, "events.jsonl", &events(config).unwrap_or_default())?;
        for (name, path) in [("readiness.json", "/readyz"), ("metrics.txt", "/metrics")] {
            if let Some(body) = running::get_text(config.listen, path).await {
                add(&mut archive, name, &body)?;
            }
        }
    }
    let log = ["--unit=wsg-gateway", "--no-pager", "--lines", LOG_LINES];
    add(&mut archive, "log.txt", &output("journalctl", &log))?;
    archive.into_inner()?.finish()?.sync_all()?;
    Ok(())
}

fn add(archive: &mut Builder<impl std::io::Write>, name: &str, text: &str) -> std::io::Result<()> {
    let mut header = Header::new_gnu();
    header.set_size(text.len() as u64);
    header.set_mode(0o600);
    archive.append_data(&mut header, name, text.as_bytes())
}

/// Describes the machine.
fn system() -> String {
    let commands: [(&str, &[&str]); 4] =
        [("uname", &["-a"]), ("ip", &["-details", "address"]), ("df", &["-h"]), ("timedatectl", &[])];
    let outputs = commands.map(|(program, arguments)| format!("# {program}\n{}\n", output(program, arguments)));
    let files = ["/etc/os-release", "/proc/uptime", "/proc/meminfo"];
    let files = files.map(|path| format!("# {path}\n{}\n", fs::read_to_string(path).unwrap_or_default()));
    [outputs.concat(), files.concat()].concat()
}

/// Returns what a program prints; empty if it does not exist.
fn output(program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program).args(arguments).output();
    output.map(|output| String::from_utf8_lossy(&output.stdout).into_owned()).unwrap_or_default()
}

/// Returns a configuration without secrets. A file that is not valid TOML is left out, because nothing tells where its
/// secrets are.
fn redacted(text: &str) -> String {
    match text.parse::<toml::Table>() {
        Ok(table) => {
            let mut value = toml::Value::Table(table);
            redact("", &mut value);
            value.to_string()
        }
        Err(error) => format!("# left out, because it is not valid: {}\n", error.message()),
    }
}

fn redact(key: &str, value: &mut toml::Value) {
    match value {
        toml::Value::Table(table) => table.iter_mut().for_each(|(key, value)| redact(key, value)),
        toml::Value::Array(items) => items.iter_mut().for_each(|item| redact(key, item)),
        toml::Value::String(text) => {
            // The path of a file is not secret.
            if SECRET_WORDS.iter().any(|word| key.contains(word)) && !key.ends_with("_file") {
                REDACTED.clone_into(text);
            } else if let Ok(mut url) = text.parse::<Url>()
                && ["http", "https"].contains(&url.scheme())
            {
                // A receiver's URL can contain a secret.
                url.set_path(REDACTED);
                url.set_query(None);
                *text = url.into();
            }
        }
        _ => {}
    }
}

/// Returns the newest events, without the ids and descriptions of parts.
fn events(config: &Config) -> Option<String> {
    let JournalLocation::File(path) = &config.journal.place else { return None };
    let query = EventQuery { limit: Limit::new(EVENTS).ok()?, ..EventQuery::default() };
    let page = Reader::open(path).ok()?.events(&query).ok()?;
    let lines = page.bodies.iter().filter_map(|body| {
        let mut event = serde_json::from_str(body).ok()?;
        redact_products(&mut event);
        Some(format!("{event}\n"))
    });
    Some(lines.collect())
}

fn redact_products(value: &mut Value) {
    match value {
        Value::Object(members) => members.iter_mut().for_each(|(name, value)| match value {
            Value::String(text) if PRODUCT_MEMBERS.contains(&name.as_str()) => REDACTED.clone_into(text),
            _ => redact_products(value),
        }),
        Value::Array(items) => items.iter_mut().for_each(redact_products),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn secrets_are_redacted_and_paths_stay() {
        let text = "name = \"cell\"\n[[webhooks]]\nname = \"mes\"\nurl = \"https://mes.example/s3cret?a=s3cret\"\n\
                    secret = \"whsec_s3cret\"\nsecret_file = \"mes.secret\"\nkeys = [\"s3cret\"]\n[grippers.left]\n\
                    url = \"tcp://192.168.1.20:1000\"\n";
        let redacted = redacted(text);
        assert!(!redacted.contains("s3cret"), "{redacted}");
        for kept in ["cell", "https://mes.example/", "mes.secret", "tcp://192.168.1.20:1000"] {
            assert!(redacted.contains(kept), "{kept}: {redacted}");
        }
        assert!(super::redacted("secret = s3cret").starts_with("# left out"));
    }
    #[test]
    fn products_are_redacted_wherever_they_are() {
        let mut event = json!({
            "kind": "recipe", "part_id": "s3cret", "part": null,
            "definition": {"part_id": "s3cret", "description": "s3cret", "number": 7},
            "changes": [{"part_id": null}, {"part_id": "s3cret"}],
        });
        redact_products(&mut event);
        assert!(!event.to_string().contains("s3cret"), "{event}");
        assert_eq!((&event["definition"]["number"], &event["changes"][0]["part_id"]), (&json!(7), &Value::Null));
    }
}
