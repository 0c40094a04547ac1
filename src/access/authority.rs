//! Identification of clients by their credentials.

use std::net::IpAddr;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use ipnet::IpNet;
use jiff::Timestamp;
use serde::Deserialize;

use super::credential::{Credential, SessionId};
use super::identity::{Identity, Proof, Scope, Unauthorized};
use super::role::Role;
use super::session::Sessions;
use super::token::TokenSecret;
use super::token_file::{FileVersion, StoredToken, TokenFile, TokenFileError, TokenHash, Tokens};
use crate::gripper::model::Name;

/// Pause before a file of tokens that could not be read is read again.
const RETRIED_AFTER: Duration = Duration::from_secs(1);

/// The clients that can make a FAST STOP without a credential.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FastStopPolicy {
    /// Everyone.
    Anyone,
    /// No one: a FAST STOP needs any valid credential.
    Credential,
}

/// A client that its address identifies, since it can send no credential.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AddressClient {
    pub name: Name,
    pub network: IpNet,
    pub role: Role,
    pub scope: Scope,
}

/// Whether clients need credentials.
#[derive(Debug, Default)]
pub enum Access {
    /// Clients need none.
    #[default]
    Open,
    Guarded(Box<Guard>),
}

/// The credentials of a gateway.
#[derive(Debug)]
pub struct Guard {
    file: TokenFile,
    clients: Vec<AddressClient>,
    fast_stop: FastStopPolicy,
    network_role: Option<Role>,
    sessions: Sessions,
    cached: RwLock<Cached>,
}

/// The tokens as last read.
#[derive(Debug)]
struct Cached {
    version: Option<FileVersion>,
    tokens: Option<Arc<Tokens>>,
    /// Version that could not be read, and the time of the next attempt.
    failed: Option<(Option<FileVersion>, Instant)>,
}

impl Cached {
    fn of(read: Option<(Tokens, FileVersion)>) -> Self {
        let (tokens, version) = read.map(|(tokens, version)| (Arc::new(tokens), version)).unzip();
        Self { version, tokens, failed: None }
    }
}

impl Guard {
    /// Reads the file of tokens, which may not exist yet.
    ///
    /// # Errors
    /// [`TokenFileError`]
    pub fn new(
        file: TokenFile,
        clients: Vec<AddressClient>,
        (fast_stop, network_role): (FastStopPolicy, Option<Role>),
        idle_time: Duration,
    ) -> Result<Self, TokenFileError> {
        let cached = RwLock::new(Cached::of(file.read()?));
        Ok(Self { file, clients, fast_stop, network_role, sessions: Sessions::new(idle_time), cached })
    }

    /// Returns the tokens of the file. A file that cannot be read any more keeps its last content.
    fn tokens(&self) -> Option<Arc<Tokens>> {
        let version = self.file.version();
        let cached = self.cached.read().unwrap_or_else(PoisonError::into_inner);
        let is_failed = cached.failed.is_some_and(|(failed, until)| failed == version && Instant::now() < until);
        if cached.version == version || is_failed {
            return cached.tokens.clone();
        }
        drop(cached);
        let mut cached = self.cached.write().unwrap_or_else(PoisonError::into_inner);
        match self.file.read() {
            Ok(read) => {
                tracing::info!(file = %self.file.path().display(), "tokens read");
                *cached = Cached::of(read);
            }
            Err(error) => {
                tracing::error!(%error, "tokens not read: the gateway keeps the tokens that it knows");
                cached.failed = Some((version, Instant::now() + RETRIED_AFTER));
            }
        }
        cached.tokens.clone()
    }

    /// Identifies a client by its token, and returns the token's hash.
    fn by_token(&self, secret: &TokenSecret, proof: Proof) -> Result<(TokenHash, Identity), Unauthorized> {
        let tokens = self.tokens().ok_or(Unauthorized::Unknown)?;
        let hash = tokens.hash(secret);
        Ok((hash, Self::by_hash(&tokens, hash, proof)?))
    }

    /// Identifies a client by the token of its session.
    fn by_session(&self, hash: Option<TokenHash>) -> Result<Identity, Unauthorized> {
        let (hash, tokens) = hash.zip(self.tokens()).ok_or(Unauthorized::SessionEnded)?;
        Self::by_hash(&tokens, hash, Proof::Session).map_err(|_| Unauthorized::SessionEnded)
    }

    fn by_hash(tokens: &Tokens, hash: TokenHash, proof: Proof) -> Result<Identity, Unauthorized> {
        let token = tokens.find(hash).ok_or(Unauthorized::Unknown)?;
        let StoredToken { name, role, expires_at, .. } = token;
        if expires_at.is_some_and(|at| at <= Timestamp::now()) {
            return Err(Unauthorized::Expired);
        }
        Ok(Identity { name: Some(name.clone()), role: *role, scope: token.scope(), expires_at: *expires_at, proof })
    }

    fn by_address(&self, peer: Option<IpAddr>) -> Result<Identity, Unauthorized> {
        let peer = peer.map(|peer| peer.to_canonical());
        let client = self.clients.iter().find(|client| peer.is_some_and(|peer| client.network.contains(&peer)));
        let AddressClient { name, role, scope, .. } = client.ok_or(Unauthorized::Missing)?;
        let (name, scope, proof) = (Some(name.clone()), scope.clone(), Proof::Address);
        Ok(Identity { name, role: *role, scope, expires_at: None, proof })
    }
}

impl Access {
    /// Identifies a client by its credential, or else by its address.
    ///
    /// # Errors
    /// The reason why the client is unknown.
    pub fn identify(&self, credential: &Credential, peer: Option<IpAddr>) -> Result<Identity, Unauthorized> {
        let Self::Guarded(guard) = self else { return Ok(Identity::anyone()) };
        match credential {
            Credential::None => guard.by_address(peer),
            Credential::Malformed => Err(Unauthorized::Malformed),
            Credential::Token(secret) => guard.by_token(secret, Proof::Token).map(|(_, identity)| identity),
            Credential::Session(id) => guard.by_session(guard.sessions.used(Instant::now(), id)),
        }
    }

    /// Whether the client of a connection is still known. This does not count as a use of its session.
    #[must_use]
    pub fn knows(&self, credential: &Credential, peer: Option<IpAddr>) -> bool {
        match (self, credential) {
            (Self::Guarded(guard), Credential::Session(id)) => {
                guard.by_session(guard.sessions.token(Instant::now(), id)).is_ok()
            }
            _ => self.identify(credential, peer).is_ok(),
        }
    }

    /// Returns the identity of a client of the Zenoh network that sends no token. The network's own access control
    /// decides who receives the states, so reading them needs no token.
    #[must_use]
    pub fn of_network(&self) -> Identity {
        let role = match self {
            Self::Open => return Identity::anyone(),
            Self::Guarded(guard) => guard.network_role.unwrap_or(Role::Observer),
        };
        Identity { role, ..Identity::anyone() }
    }

    /// Whether clients need credentials.
    #[must_use]
    pub fn is_guarded(&self) -> bool {
        matches!(self, Self::Guarded(_))
    }

    /// Whether a FAST STOP needs no credential.
    #[must_use]
    pub fn lets_anyone_stop(&self) -> bool {
        match self {
            Self::Open => true,
            Self::Guarded(guard) => guard.fast_stop == FastStopPolicy::Anyone,
        }
    }

    /// Begins a session with a token. Returns `None` if the gateway needs no credentials.
    ///
    /// # Errors
    /// The reason why the token is refused.
    pub fn sign_in(&self, secret: &TokenSecret) -> Result<Option<(SessionId, Identity)>, Unauthorized> {
        let Self::Guarded(guard) = self else { return Ok(None) };
        let (hash, identity) = guard.by_token(secret, Proof::Session)?;
        let id = guard.sessions.begin(Instant::now(), hash).map_err(|_| Unauthorized::Unknown)?;
        Ok(Some((id, identity)))
    }

    /// Ends a session.
    pub fn sign_out(&self, id: &SessionId) {
        if let Self::Guarded(guard) = self {
            guard.sessions.end(id);
        }
    }
}

#[cfg(test)]
#[path = "authority_tests.rs"]
mod tests;
