//! Access control: roles, credentials, and the check of both.
//!
//! An interface collects a client's [`Credential`], and [`Access::identify`] returns the client's
//! [`Identity`]. The operations compare it with the [`Right`] that they need. No interface decides itself.

mod authority;
mod credential;
mod expiry;
mod identity;
mod known;
mod pin;
mod random;
mod role;
mod session;
mod ticket;
mod token;
mod token_file;
mod visitor;

pub use authority::{Access, AccessRules, FastStopPolicy, Guard};
pub use credential::{Credential, SessionId};
pub use expiry::{CredentialKind, ExpiringCredential};
pub use identity::{Identity, Proof, Scope, Unauthorized};
pub use known::{ClientCertificate, ClientMatch, ClientOrigin, KnownClient};
pub use pin::Pin;
pub use role::{Right, Role};
pub use session::SessionTimes;
pub use ticket::{TICKET_TIME, TicketId};
pub use token::TokenSecret;
pub use token_file::{NewToken, StoredToken, TokenFile, TokenFileError};
pub use visitor::Visitor;
