//! The file of tokens: keyed hashes, which only its owner can read.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, fchown};
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use ring::hmac;
use serde::{Deserialize, Serialize};

use super::expiry::{CredentialKind, ExpiringCredential};
use super::identity::Scope;
use super::pin::Pin;
use super::random::secret_bytes;
use super::role::Role;
use super::token::TokenSecret;
use crate::model::{Name, without_byte_order_mark};

/// Maximum number of tokens in a file.
const MAX_TOKENS: usize = 1024;

/// Permissions of the file: only its owner reads and writes it.
const MODE: u32 = 0o600;

/// Permissions that the file must not grant.
const FOR_OTHERS: u32 = 0o077;

/// A keyed hash (HMAC-SHA-256) of a token.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct TokenHash(#[serde(with = "hex::serde")] pub(super) [u8; 32]);

/// A token without its secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoredToken {
    pub name: Name,
    pub role: Role,
    /// The grippers that the token is for; absent for all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grippers: Option<BTreeSet<Name>>,
    pub created_at: Timestamp,
    /// Absent if the token does not expire.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expires_at: Option<Timestamp>,
    /// Whether the secret is a PIN, which only adds rights to a session.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_pin: bool,
    hash: TokenHash,
}

/// A token to be created.
#[derive(Debug, Clone)]
pub struct NewToken {
    pub name: Name,
    pub role: Role,
    pub grippers: Option<BTreeSet<Name>>,
    pub expires_at: Option<Timestamp>,
}

/// A file of tokens.
#[derive(Debug, Clone)]
pub struct TokenFile {
    path: PathBuf,
}

/// The tokens of a file, and the key of their hashes.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tokens {
    key: HashKey,
    tokens: Vec<StoredToken>,
}

#[derive(Clone, Serialize, Deserialize)]
struct HashKey(#[serde(with = "hex::serde")] [u8; 32]);

impl std::fmt::Debug for HashKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("…")
    }
}

/// Identifies one version of a file: its inode, size, and the times at which content and permissions changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FileVersion([i64; 6]);

/// Reason why tokens cannot be read or changed, with the remedy.
#[derive(Debug, thiserror::Error)]
pub enum TokenFileError {
    #[error("{path}: {cause}")]
    Io { path: PathBuf, cause: io::Error },
    #[error("{path} can be read by others (mode {mode:03o}): run chmod 600 {path}")]
    Exposed { path: PathBuf, mode: u32 },
    #[error("{path} is not a file of tokens: {cause}")]
    Malformed { path: PathBuf, cause: serde_json::Error },
    #[error("a token named {0} exists: revoke it first, or choose another name")]
    Exists(Name),
    #[error("no token is named {0}: wsg-gateway token list shows all")]
    NotFound(Name),
    #[error("the file has {MAX_TOKENS} tokens, which is the maximum: revoke some")]
    Full,
    #[error("the operating system has no random numbers")]
    NoRandom,
}

impl From<ring::error::Unspecified> for TokenFileError {
    fn from(_: ring::error::Unspecified) -> Self {
        Self::NoRandom
    }
}

impl TokenFile {
    #[must_use]
    pub fn at(path: PathBuf) -> Self {
        Self { path }
    }

    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Adds a token and returns its secret. Creates the file if it does not exist.
    ///
    /// # Errors
    /// [`TokenFileError`]
    pub fn create(&self, now: Timestamp, new: NewToken) -> Result<TokenSecret, TokenFileError> {
        let secret = TokenSecret::generate()?;
        self.change(|content| content.add(now, new, content.hash(&secret), false))?;
        Ok(secret)
    }

    /// Adds a PIN and returns it. Creates the file if it does not exist.
    ///
    /// # Errors
    /// [`TokenFileError`]
    pub fn create_pin(&self, now: Timestamp, new: NewToken) -> Result<Pin, TokenFileError> {
        let mut pin = Pin::generate()?;
        self.change(|content| {
            // Two people must not have the same PIN.
            while content.find_pin(content.hash_of_pin(&pin)).is_some() {
                pin = Pin::generate()?;
            }
            content.add(now, new, content.hash_of_pin(&pin), true)
        })?;
        Ok(pin)
    }

    /// Removes a token.
    ///
    /// # Errors
    /// [`TokenFileError`]
    pub fn revoke(&self, name: &Name) -> Result<(), TokenFileError> {
        self.change(|content| {
            let before = content.tokens.len();
            content.tokens.retain(|token| token.name != *name);
            if content.tokens.len() < before { Ok(()) } else { Err(TokenFileError::NotFound(name.clone())) }
        })
    }

    /// Returns all tokens, without their secrets. A missing file has none.
    ///
    /// # Errors
    /// [`TokenFileError`]
    pub fn list(&self) -> Result<Vec<StoredToken>, TokenFileError> {
        Ok(self.read()?.map_or_else(Vec::new, |(content, _)| content.tokens))
    }

    /// The current version of the file; `None` if the file does not exist.
    pub(super) fn version(&self) -> Option<FileVersion> {
        fs::metadata(&self.path).ok().map(|metadata| FileVersion::of(&metadata))
    }

    pub(super) fn read(&self) -> Result<Option<(Tokens, FileVersion)>, TokenFileError> {
        let mut file = match File::open(&self.path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            file => file.map_err(|cause| self.failed(cause))?,
        };
        let metadata = file.metadata().map_err(|cause| self.failed(cause))?;
        if metadata.mode() & FOR_OTHERS != 0 {
            return Err(TokenFileError::Exposed { path: self.path.clone(), mode: metadata.mode() & 0o777 });
        }
        let mut text = Vec::new();
        file.read_to_end(&mut text).map_err(|cause| self.failed(cause))?;
        let content = serde_json::from_slice(without_byte_order_mark(&text));
        let content = content.map_err(|cause| TokenFileError::Malformed { path: self.path.clone(), cause })?;
        Ok(Some((content, FileVersion::of(&metadata))))
    }

    /// Changes the content as one step. Other changes wait, and readers see the content before or after it.
    fn change(&self, change: impl FnOnce(&mut Tokens) -> Result<(), TokenFileError>) -> Result<(), TokenFileError> {
        let directory = self.path.parent().filter(|parent| !parent.as_os_str().is_empty());
        let directory = directory.unwrap_or(Path::new("."));
        fs::create_dir_all(directory).map_err(|cause| self.failed(cause))?;
        let lock = File::open(directory).map_err(|cause| self.failed(cause))?;
        lock.lock().map_err(|cause| self.failed(cause))?;
        let mut content = match self.read()? {
            Some((content, _)) => content,
            None => Tokens::new()?,
        };
        change(&mut content)?;
        self.write(&content).map_err(|cause| self.failed(cause))
    }

    fn write(&self, content: &Tokens) -> io::Result<()> {
        let unfinished = self.path.with_extension("unfinished");
        // A leftover of a killed process, or a link planted by another user. It must not decide where, and with which
        // permissions, the tokens are written.
        match fs::remove_file(&unfinished) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let mut file = OpenOptions::new().write(true).create_new(true).mode(MODE).open(&unfinished)?;
        // If another user such as root changes the file, its owner stays, so that the gateway can still read the file.
        if let Ok(old) = fs::metadata(&self.path)
            && old.uid() != file.metadata()?.uid()
        {
            fchown(&file, Some(old.uid()), Some(old.gid()))?;
        }
        file.write_all(&serde_json::to_vec_pretty(content)?)?;
        file.sync_all()?;
        fs::rename(unfinished, &self.path)
    }

    fn failed(&self, cause: io::Error) -> TokenFileError {
        TokenFileError::Io { path: self.path.clone(), cause }
    }
}

impl FileVersion {
    fn of(metadata: &fs::Metadata) -> Self {
        let inode = metadata.ino().cast_signed();
        let size = metadata.size().cast_signed();
        let changed = (metadata.mtime(), metadata.mtime_nsec());
        let set = (metadata.ctime(), metadata.ctime_nsec());
        Self([inode, size, changed.0, changed.1, set.0, set.1])
    }
}

impl Tokens {
    fn new() -> Result<Self, TokenFileError> {
        Ok(Self { key: HashKey(secret_bytes()?), tokens: Vec::new() })
    }

    fn add(&mut self, now: Timestamp, new: NewToken, hash: TokenHash, is_pin: bool) -> Result<(), TokenFileError> {
        let NewToken { name, role, grippers, expires_at } = new;
        if self.tokens.iter().any(|token| token.name == name) {
            return Err(TokenFileError::Exists(name));
        }
        if self.tokens.len() >= MAX_TOKENS {
            return Err(TokenFileError::Full);
        }
        self.tokens.push(StoredToken { name, role, grippers, created_at: now, expires_at, is_pin, hash });
        Ok(())
    }

    /// Hashes a secret. Its keyed hash is compared instead of the secret, so the time of a comparison reveals nothing.
    pub(super) fn hash(&self, secret: &TokenSecret) -> TokenHash {
        self.hash_of(secret.expose())
    }

    pub(super) fn hash_of_pin(&self, pin: &Pin) -> TokenHash {
        self.hash_of(pin.expose())
    }

    fn hash_of(&self, secret: &str) -> TokenHash {
        let key = hmac::Key::new(hmac::HMAC_SHA256, &self.key.0);
        let mut hash = [0; 32];
        hash.copy_from_slice(hmac::sign(&key, secret.as_bytes()).as_ref());
        TokenHash(hash)
    }

    /// The tokens that expire.
    pub(super) fn expiring(&self) -> Vec<ExpiringCredential> {
        self.tokens.iter().filter_map(StoredToken::expiry).collect()
    }

    pub(super) fn find(&self, hash: TokenHash) -> Option<&StoredToken> {
        self.tokens.iter().find(|token| !token.is_pin && token.hash == hash)
    }

    pub(super) fn find_pin(&self, hash: TokenHash) -> Option<&StoredToken> {
        self.tokens.iter().find(|token| token.is_pin && token.hash == hash)
    }
}

impl StoredToken {
    /// The token's end; `None` if it does not expire.
    #[must_use]
    pub fn expiry(&self) -> Option<ExpiringCredential> {
        Some(ExpiringCredential {
            kind: CredentialKind::Token,
            name: self.name.as_str().into(),
            valid_from: self.created_at,
            expires_at: self.expires_at?,
        })
    }

    /// The grippers that the token is for.
    #[must_use]
    pub fn scope(&self) -> Scope {
        self.grippers.clone().map_or(Scope::All, Scope::Only)
    }
}

#[cfg(test)]
#[path = "token_file_tests.rs"]
mod tests;
