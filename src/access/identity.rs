//! The identity of a client, and the rights that come with it.

use std::collections::BTreeSet;

use jiff::Timestamp;
use serde::Serialize;
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::credential::SessionId;
use super::role::{Right, Role};
use super::token::NotAToken;
use crate::model::Name;

/// A client that the gateway knows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// Name of the client's credential; `None` on a gateway that needs no credentials.
    pub name: Option<Name>,
    pub role: Role,
    pub scope: Scope,
    /// Time at which the credential expires, if it does.
    pub expires_at: Option<Timestamp>,
    pub proof: Proof,
    /// The browser's session that the client uses.
    pub session: Option<SessionId>,
}

/// Grippers that a client may stop, move or change. A client with the right to read reads all grippers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Scope {
    All,
    Only(BTreeSet<Name>),
}

/// The evidence of a client's identity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "lowercase")]
pub enum Proof {
    /// Nothing; the gateway needs no credentials.
    None,
    /// A token.
    Token,
    /// A session in a browser, which began with a token.
    Session,
    /// A PIN, entered in a session.
    Pin,
    /// The client's certificate.
    Certificate,
    /// The client's address.
    Address,
}

/// Reason why a client is unknown, with the remedy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Unauthorized {
    #[error("this request needs a credential: send a token as \"Authorization: Bearer wsg_…\", or sign in")]
    Missing,
    #[error("the Authorization header must be \"Bearer\", a space and a token, and must be sent once")]
    Malformed,
    #[error(transparent)]
    NotAToken(#[from] NotAToken),
    #[error("this token is unknown or was revoked: ask for a new one")]
    Unknown,
    #[error("this token has expired: ask for a new one")]
    Expired,
    #[error("this session has ended: sign in again")]
    SessionEnded,
    #[error("this ticket was used, has expired or is unknown: get a new one with POST /api/v1/tickets")]
    InvalidTicket,
    #[error("this PIN is wrong or was revoked")]
    WrongPin,
    #[error("too many wrong PINs: wait five minutes")]
    TooManyPins,
}

impl Identity {
    /// Returns the identity of every client of a gateway that needs no credentials.
    #[must_use]
    pub const fn anyone() -> Self {
        let role = Role::Supervisor;
        let scope = Scope::All;
        let proof = Proof::None;
        Self { name: None, role, scope, expires_at: None, proof, session: None }
    }

    /// Whether the client has a right to this gripper; `None` stands for all grippers.
    #[must_use]
    pub fn may(&self, right: Right, gripper: Option<&Name>) -> bool {
        let is_in_scope = match right {
            Right::FastStop | Right::Read => true,
            Right::Stop | Right::Operate | Right::Supervise => self.scope.contains(gripper),
        };
        self.role.has(right) && is_in_scope
    }
}

impl Scope {
    /// Whether the scope contains this gripper; `None` stands for all grippers.
    #[must_use]
    pub fn contains(&self, gripper: Option<&Name>) -> bool {
        match self {
            Self::All => true,
            Self::Only(grippers) => gripper.is_some_and(|gripper| grippers.contains(gripper)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scope_limits_everything_but_fast_stops_and_reads() {
        let [left, right]: [Name; 2] = ["left", "right"].map(|name| name.parse().unwrap());
        let scope = Scope::Only([left.clone()].into());
        let operator = Identity { role: Role::Operator, scope, ..Identity::anyone() };
        assert!(operator.may(Right::Operate, Some(&left)) && operator.may(Right::Stop, Some(&left)));
        for other in [Some(&right), None] {
            assert!(!operator.may(Right::Operate, other) && !operator.may(Right::Stop, other));
            assert!(operator.may(Right::FastStop, other) && operator.may(Right::Read, other));
        }
        assert!(!operator.may(Right::Supervise, Some(&left)));
    }
}
