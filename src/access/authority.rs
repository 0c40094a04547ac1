//! Identification of clients by their credentials.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::credential::{Credential, SessionId};
use super::expiry::ExpiringCredential;
use super::identity::{Identity, Proof, Unauthorized};
use super::known::{ClientOrigin, KnownClient};
use super::pin::Pin;
use super::role::{Right, Role};
use super::session::{SessionCredentials, SessionTimes, Sessions};
use super::ticket::{TicketId, Tickets};
use super::token::TokenSecret;
use super::token_file::{FileVersion, StoredToken, TokenFile, TokenFileError, TokenHash, Tokens};
use crate::model::Name;

/// Pause before a file of tokens that could not be read is read again.
const RETRIED_AFTER: Duration = Duration::from_secs(1);

/// What a FAST STOP needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "lowercase")]
pub enum FastStopPolicy {
    /// Nothing.
    Anyone,
    /// Any valid credential.
    Credential,
}

/// Identifies clients, by rules that a reload can change.
#[derive(Debug, Default)]
pub struct Access {
    rules: RwLock<Arc<AccessRules>>,
    sessions: Sessions,
    tickets: Tickets,
}

/// Whether clients need credentials.
#[derive(Debug, Default)]
pub enum AccessRules {
    /// Clients need none.
    #[default]
    Open,
    Guarded(Box<Guard>),
}

/// The credentials of a gateway.
#[derive(Debug)]
pub struct Guard {
    file: TokenFile,
    clients: Vec<KnownClient>,
    fast_stop: FastStopPolicy,
    network_role: Option<Role>,
    times: SessionTimes,
    /// Whether the network can read the credentials.
    is_exposed: bool,
    cached: RwLock<Cached>,
    /// Expired tokens that were refused since the file was read.
    refused: Mutex<HashSet<Name>>,
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
        clients: Vec<KnownClient>,
        (fast_stop, network_role): (FastStopPolicy, Option<Role>),
        times: SessionTimes,
    ) -> Result<Self, TokenFileError> {
        let cached = RwLock::new(Cached::of(file.read()?));
        let refused = Mutex::default();
        Ok(Self { file, clients, fast_stop, network_role, times, is_exposed: false, cached, refused })
    }

    /// Notes whether the network can read the credentials.
    #[must_use]
    pub fn exposed(self, is_exposed: bool) -> Self {
        Self { is_exposed, ..self }
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
                self.refused.lock().unwrap_or_else(PoisonError::into_inner).clear();
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
        Ok((hash, self.by_hash(&tokens, hash, proof)?))
    }

    /// Identifies a client by its session: as the person whose PIN was entered there, or else by the session's token.
    fn by_session(&self, credentials: Option<SessionCredentials>) -> Result<Identity, Unauthorized> {
        let (SessionCredentials { token, pin }, tokens) =
            credentials.zip(self.tokens()).ok_or(Unauthorized::SessionEnded)?;
        let identity = self.by_hash(&tokens, token, Proof::Session).map_err(|_| Unauthorized::SessionEnded)?;
        let person = pin.and_then(|pin| self.valid(tokens.find_pin(pin)?, Proof::Pin).ok());
        Ok(person.unwrap_or(identity))
    }

    /// Identifies a person by a PIN, and returns the PIN's hash.
    fn by_pin(&self, pin: &Pin) -> Result<(TokenHash, Identity), Unauthorized> {
        let tokens = self.tokens().ok_or(Unauthorized::WrongPin)?;
        let hash = tokens.hash_of_pin(pin);
        Ok((hash, self.valid(tokens.find_pin(hash).ok_or(Unauthorized::WrongPin)?, Proof::Pin)?))
    }

    /// Whether the token of a session allows no more than reads.
    fn only_reads(&self, token: TokenHash) -> bool {
        self.tokens().is_some_and(|tokens| tokens.find(token).is_some_and(|token| !token.role.has(Right::Operate)))
    }

    fn by_hash(&self, tokens: &Tokens, hash: TokenHash, proof: Proof) -> Result<Identity, Unauthorized> {
        self.valid(tokens.find(hash).ok_or(Unauthorized::Unknown)?, proof)
    }

    /// Returns the identity that comes with a token, if the token has not expired.
    fn valid(&self, token: &StoredToken, proof: Proof) -> Result<Identity, Unauthorized> {
        let StoredToken { name, role, expires_at, .. } = token;
        if let Some(at) = expires_at.filter(|at| *at <= Timestamp::now()) {
            self.log_expired(name, at);
            return Err(Unauthorized::Expired);
        }
        Ok(Identity {
            name: Some(name.clone()),
            role: *role,
            scope: token.scope(),
            expires_at: *expires_at,
            proof,
            session: None,
        })
    }

    /// Logs the first refusal of an expired token. The client of a machine repeats its requests without end.
    fn log_expired(&self, name: &Name, at: Timestamp) {
        let is_first = self.refused.lock().unwrap_or_else(PoisonError::into_inner).insert(name.clone());
        if is_first {
            let expired_at = format!("{at:.0}");
            tracing::warn!(token = %name, expired_at, "expired token refused: create another one with wsg-gateway token create");
        }
    }
}

impl Access {
    #[must_use]
    pub fn new(rules: AccessRules) -> Self {
        let access = Self::default();
        access.replace(rules);
        access
    }

    /// Replaces the rules. Open sessions stay open, if their tokens are still valid.
    pub fn replace(&self, rules: AccessRules) {
        *self.rules.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(rules);
    }

    fn rules(&self) -> Arc<AccessRules> {
        self.rules.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Identifies a client by its credential, or else by its origin.
    ///
    /// # Errors
    /// The reason why the client is unknown.
    pub fn identify(&self, credential: &Credential, origin: &ClientOrigin) -> Result<Identity, Unauthorized> {
        let AccessRules::Guarded(guard) = &*self.rules() else { return Ok(Identity::anyone()) };
        match credential {
            Credential::None => KnownClient::find(&guard.clients, origin).ok_or(Unauthorized::Missing),
            Credential::Malformed => Err(Unauthorized::Malformed),
            Credential::NotAToken(error) => Err((*error).into()),
            Credential::InvalidTicket => Err(Unauthorized::InvalidTicket),
            Credential::Token(secret) => guard.by_token(secret, Proof::Token).map(|(_, identity)| identity),
            Credential::Session(id) => {
                let identity = guard.by_session(self.sessions.credentials(Instant::now(), guard.times, id))?;
                Ok(Identity { session: Some(id.clone()), ..identity })
            }
        }
    }

    /// Notes that the client does something, so that its session is not idle. The reads of an open page count only for
    /// those who cannot do more, such as a panel that stays signed in.
    pub fn note_use(&self, session: &SessionId, is_change: bool) {
        let AccessRules::Guarded(guard) = &*self.rules() else { return };
        let now = Instant::now();
        let credentials = self.sessions.credentials(now, guard.times, session);
        if is_change || credentials.is_some_and(|credentials| guard.only_reads(credentials.token)) {
            self.sessions.note_use(now, session, is_change);
        }
    }

    /// Returns the identity of a client of the WSG port, which can send no credential. `None` if the gateway names no
    /// clients, so that it knows none of them.
    #[must_use]
    pub fn of_address(&self, origin: &ClientOrigin) -> Option<Identity> {
        match &*self.rules() {
            AccessRules::Open => None,
            AccessRules::Guarded(guard) => KnownClient::find(&guard.clients, origin),
        }
    }

    /// Returns the identity of a client of the Zenoh network that sends no token. The network's own access control
    /// decides who receives the states, so reading them needs no token.
    #[must_use]
    pub fn of_network(&self) -> Identity {
        let role = match &*self.rules() {
            AccessRules::Open => return Identity::anyone(),
            AccessRules::Guarded(guard) => guard.network_role.unwrap_or(Role::Observer),
        };
        Identity { role, ..Identity::anyone() }
    }

    /// The tokens that expire.
    #[must_use]
    pub fn expiring(&self) -> Vec<ExpiringCredential> {
        match &*self.rules() {
            AccessRules::Open => Vec::new(),
            AccessRules::Guarded(guard) => guard.tokens().map(|tokens| tokens.expiring()).unwrap_or_default(),
        }
    }

    /// Whether clients need credentials.
    #[must_use]
    pub fn is_guarded(&self) -> bool {
        matches!(*self.rules(), AccessRules::Guarded(_))
    }

    /// Whether the network can read the credentials of clients.
    #[must_use]
    pub fn is_exposed(&self) -> bool {
        matches!(&*self.rules(), AccessRules::Guarded(guard) if guard.is_exposed)
    }

    /// Returns what a FAST STOP needs.
    #[must_use]
    pub fn fast_stop(&self) -> FastStopPolicy {
        match &*self.rules() {
            AccessRules::Open => FastStopPolicy::Anyone,
            AccessRules::Guarded(guard) => guard.fast_stop,
        }
    }

    /// Whether a FAST STOP needs no credential.
    #[must_use]
    pub fn lets_anyone_stop(&self) -> bool {
        self.fast_stop() == FastStopPolicy::Anyone
    }

    /// Begins a session with a token. Returns `None` if the gateway needs no credentials.
    ///
    /// # Errors
    /// The reason why the token is refused.
    pub fn sign_in(&self, secret: &TokenSecret) -> Result<Option<(SessionId, Identity)>, Unauthorized> {
        let AccessRules::Guarded(guard) = &*self.rules() else { return Ok(None) };
        let (hash, identity) = guard.by_token(secret, Proof::Session)?;
        let id = self.sessions.begin(Instant::now(), guard.times, hash).map_err(|_| Unauthorized::Unknown)?;
        Ok(Some((id, identity)))
    }

    /// Ends a session.
    pub fn sign_out(&self, id: &SessionId) {
        self.sessions.end(id);
    }

    /// Gives a session the identity of a PIN in place of its own, until it is unused for [`SessionTimes::pin_idle`].
    ///
    /// # Errors
    /// The reason why the PIN is refused.
    pub fn enter_pin(&self, id: &SessionId, pin: &Pin) -> Result<Identity, Unauthorized> {
        let AccessRules::Guarded(guard) = &*self.rules() else { return Err(Unauthorized::SessionEnded) };
        let now = Instant::now();
        let credentials = self.sessions.credentials(now, guard.times, id).ok_or(Unauthorized::SessionEnded)?;
        guard.by_session(Some(credentials))?;
        if !self.sessions.count_pin_attempt(now, credentials.token) {
            return Err(Unauthorized::TooManyPins);
        }
        let (hash, identity) =
            guard.by_pin(pin).inspect_err(|_| self.sessions.note_wrong_pin(now, credentials.token))?;
        self.sessions.add_pin(now, id, hash);
        Ok(identity)
    }

    /// Issues a ticket, which stands for this credential once.
    ///
    /// # Errors
    /// The operating system has no random numbers.
    pub fn issue_ticket(&self, credential: &Credential) -> Result<TicketId, ring::error::Unspecified> {
        self.tickets.issue(Instant::now(), credential)
    }

    /// Takes a ticket, and returns the credential that it stands for.
    #[must_use]
    pub fn take_ticket(&self, id: &TicketId) -> Credential {
        self.tickets.take(Instant::now(), id).unwrap_or(Credential::InvalidTicket)
    }

    /// Takes the rights of a PIN away from a session.
    pub fn forget_pin(&self, id: &SessionId) {
        self.sessions.remove_pin(id);
    }
}

#[cfg(test)]
#[path = "authority_tests.rs"]
mod tests;
