//! Checks of the gateway's files: their owner, their secrets, the journal and its disk.

use std::fs;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use rustix::fs::{Access, access, statvfs};

use super::serial::Account;
use super::{Diagnosis, Installation};
use crate::access::{ExpiringCredential, StoredToken, TokenFile};
use crate::config::{AccessConfig, Guarded, JournalLocation};
use crate::connections::tls::Tls;
use crate::journal::Reader;

/// Free space below which a journal soon fails: a few times its write-ahead log.
const LEAST_FREE: u64 = 64 << 20;

/// Permission bits that let every user read a file.
const FOR_ALL: u32 = 0o004;

/// Keys whose values are files with secrets, besides those that the configuration knows.
const SECRET_FILES: &[&str] = &["secret_file", "password_file", "key_file"];

/// Keys whose values are secrets.
const SECRETS: &[&str] = &["secret"];

const MB: u64 = 1_000_000;

/// Warns of root, who can read and write everything.
pub(super) fn user(_: &Installation) -> Vec<Diagnosis> {
    match Account::of_service() {
        Some(service) if rustix::process::geteuid().is_root() => vec![Diagnosis::warning(
            "user",
            format_args!(
                "this is root, so some permissions of {0} cannot be checked: run `sudo -u {0} env \
                 STATE_DIRECTORY=/var/lib/{0} wsg-gateway doctor` with the same flags",
                service.name
            ),
        )],
        _ => vec![],
    }
}

/// Checks that only the gateway's user can read files with secrets.
pub(super) fn secrets(installation: &Installation) -> Vec<Diagnosis> {
    let config = &installation.config;
    let mut files: Vec<_> = config.tls.iter().map(|tls| tls.key.clone()).collect();
    if let Some(file) = &installation.file {
        files.extend(named(file));
    }
    let mut findings: Vec<_> = files.iter().filter_map(|file| exposed(file)).collect();
    if let Some(files) = config.tls.clone() {
        let certificate = files.certificate.clone();
        findings.push(match Tls::new(files).map(|tls| tls.expiry()) {
            Ok(Some(expiry)) => judge_expiry("tls", &expiry, Timestamp::now())
                .unwrap_or_else(|| Diagnosis::good("tls", certificate.display())),
            Ok(None) => Diagnosis::good("tls", certificate.display()),
            Err(error) => Diagnosis::problem("tls", error),
        });
    }
    if let AccessConfig::Guarded(Guarded { tokens: path, clients, .. }) = &config.access {
        let shown = path.display();
        match TokenFile::at(path.clone()).list() {
            Ok(tokens) if tokens.is_empty() && !clients.is_empty() => findings.push(Diagnosis::good(
                "tokens",
                format_args!("{shown} has no token, so only the clients in [[clients]] have rights"),
            )),
            Ok(tokens) if tokens.is_empty() => {
                let state = if path.exists() { "has no token" } else { "does not exist" };
                let remedy = "check the path, or create a token with `wsg-gateway token create`";
                let text = format!("{shown} {state}, so nobody can sign in: {remedy}");
                findings.push(Diagnosis::warning("tokens", text));
            }
            Ok(tokens) => findings.extend(judge_tokens(&tokens, Timestamp::now())),
            Err(error) => findings.push(Diagnosis::problem("tokens", error)),
        }
    }
    findings
}

/// Counts the valid tokens, and names each one that ends soon or has ended.
fn judge_tokens(tokens: &[StoredToken], now: Timestamp) -> Vec<Diagnosis> {
    let expiring: Vec<_> = tokens.iter().filter_map(StoredToken::expiry).collect();
    let expired = expiring.iter().filter(|token| token.has_expired(now)).count();
    let valid = tokens.len() - expired;
    let counted = match expired {
        0 => Diagnosis::good("tokens", format_args!("tokens: {valid}")),
        _ => Diagnosis::warning("tokens", format_args!("valid tokens: {valid}, expired ones: {expired}")),
    };
    let notices = expiring.iter().filter_map(|token| judge_expiry("tokens", token, now));
    std::iter::once(counted).chain(notices).collect()
}

/// Warns of a credential that ends soon or has ended.
fn judge_expiry(check: &'static str, credential: &ExpiringCredential, now: Timestamp) -> Option<Diagnosis> {
    if !credential.has_expired(now) && !credential.needs_attention(now) {
        return None;
    }
    let ExpiringCredential { kind, name, .. } = credential;
    Some(Diagnosis::warning(check, format_args!("{kind} {name} {}", credential.notice(now))))
}

/// Returns the files with secrets that a configuration file names, and the file itself if it contains a secret.
fn named(file: &Path) -> Vec<PathBuf> {
    let table = fs::read_to_string(file).ok().and_then(|text| text.parse::<toml::Table>().ok());
    let Some(table) = table.map(toml::Value::Table) else { return vec![] };
    let mut files = Vec::new();
    let mut has_secret = false;
    values(&table, &mut |key, value| {
        has_secret |= SECRETS.contains(&key);
        if SECRET_FILES.contains(&key) {
            files.push(file.parent().map_or_else(|| value.into(), |directory| directory.join(value)));
        }
    });
    files.extend(has_secret.then(|| file.to_owned()));
    files
}

/// Visits each text in a configuration, with its key.
fn values<'a>(value: &'a toml::Value, visit: &mut impl FnMut(&'a str, &'a str)) {
    match value {
        toml::Value::Table(table) => table.iter().for_each(|(key, value)| match value {
            toml::Value::String(text) => visit(key, text),
            value => values(value, visit),
        }),
        toml::Value::Array(items) => items.iter().for_each(|item| values(item, visit)),
        _ => {}
    }
}

fn exposed(file: &Path) -> Option<Diagnosis> {
    let mode = fs::metadata(file).ok()?.permissions().mode();
    let file = file.display();
    (mode & FOR_ALL != 0).then(|| {
        Diagnosis::problem(
            "secrets",
            format_args!("every user of this machine can read {file}, which contains a secret: run `chmod o= {file}`"),
        )
    })
}

pub(super) fn journal(installation: &Installation) -> Vec<Diagnosis> {
    let JournalLocation::File(path) = &installation.config.journal.place else {
        return vec![Diagnosis::warning(
            "journal",
            "in memory: records are lost when the gateway ends; name a file with --journal",
        )];
    };
    let shown = path.display();
    let directory = directory(path);
    if path.exists() {
        if let Err(error) = access(path, Access::READ_OK | Access::WRITE_OK) {
            let remedy = "give the gateway's user read and write access to the file";
            return vec![Diagnosis::problem("journal", format_args!("{shown} cannot be written ({error}): {remedy}"))];
        }
        return vec![match Reader::open(path) {
            Ok(_) => Diagnosis::good("journal", shown),
            Err(error) => Diagnosis::problem("journal", error),
        }];
    }
    let Some(existing) = directory.ancestors().find(|directory| directory.exists()) else { return vec![] };
    let existing_shown = existing.display();
    if !existing.is_dir() {
        let text = format!(
            "the journal's directory {} cannot be created, because {existing_shown} is a file: set another --journal",
            directory.display()
        );
        return vec![Diagnosis::problem("journal", text)];
    }
    if let Err(error) = access(existing, Access::WRITE_OK | Access::EXEC_OK) {
        let text = format!(
            "the journal {shown} cannot be created in {existing_shown} ({error}): let the gateway's user write there, \
             or set another --journal"
        );
        return vec![Diagnosis::problem("journal", text)];
    }
    if existing == directory {
        return vec![Diagnosis::good("journal", format_args!("{shown} will be created at the first start"))];
    }
    let text = format!(
        "the journal's directory {} does not exist: check --journal and that its disk is mounted; otherwise the gateway \
         creates the directory",
        directory.display()
    );
    vec![Diagnosis::warning("journal", text)]
}

pub(super) fn disk(installation: &Installation) -> Vec<Diagnosis> {
    let JournalLocation::File(path) = &installation.config.journal.place else { return vec![] };
    let directory = directory(path);
    let Some(existing) = directory.ancestors().find(|directory| directory.is_dir()) else { return vec![] };
    let Ok(disk) = statvfs(existing) else { return vec![] };
    let used = fs::metadata(path).map_or(0, |file| file.size());
    vec![space(existing, disk.f_bavail * disk.f_frsize, used, installation.config.journal.max_bytes)]
}

/// Judges the free space in bytes, next to a journal of `used` bytes that can grow to `limit`.
fn space(directory: &Path, free: u64, used: u64, limit: Option<u64>) -> Diagnosis {
    let directory = directory.display();
    let free_mb = free / MB;
    if free < LEAST_FREE {
        let remedy = "free some space, because motions are refused while the journal cannot be written";
        return Diagnosis::problem("disk", format_args!("{free_mb} MB are free in {directory}: {remedy}"));
    }
    match limit.map(|limit| limit.saturating_sub(used)) {
        Some(growth) if growth <= free => Diagnosis::good("disk", format_args!("{free_mb} MB are free in {directory}")),
        growth => {
            let growth = growth.map_or("without limit".to_owned(), |growth| format!("by {} MB", growth / MB));
            let remedy = "set a smaller journal_max_size_mb, or use a larger disk";
            Diagnosis::warning(
                "disk",
                format_args!("{free_mb} MB are free in {directory}, but the journal can grow {growth}: {remedy}"),
            )
        }
    }
}

/// Returns the directory of a journal.
fn directory(journal: &Path) -> PathBuf {
    let directory = journal.parent().filter(|directory| !directory.as_os_str().is_empty());
    let directory = directory.unwrap_or(Path::new("."));
    std::path::absolute(directory).unwrap_or_else(|_| directory.to_owned())
}

#[cfg(test)]
mod tests {
    use super::super::Severity;
    use super::*;

    #[test]
    fn full_disk_is_a_problem_and_a_small_one_a_warning() {
        let space = |free, used, limit| space(Path::new("/var"), free, used, limit);
        assert_eq!(space(1 << 20, 0, Some(1)).severity, Severity::Problem);
        assert_eq!(space(1 << 30, 0, Some(2 << 30)).severity, Severity::Warning);
        assert_eq!(space(1 << 30, 3 << 29, Some(2 << 30)).severity, Severity::Good);
        let unlimited = space(1 << 30, 0, None);
        assert_eq!(unlimited.severity, Severity::Warning);
        assert!(unlimited.text.contains("grow without limit: set a smaller journal_max_size_mb"), "{unlimited}");
    }
}
