//! Roles of clients, and the rights that they have.

use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

/// The rights of a client. Every role may trigger FAST STOPs, and may read over Modbus and on the WSG port.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Hash,
    Serialize,
    Deserialize,
    ToSchema,
    strum::Display,
    strum::EnumString,
    VariantArray,
    EnumMessage,
)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum Role {
    /// Also triggers Stops, but has no other rights, e.g. for the controller of a light curtain.
    Stop,
    /// Reads.
    Observer,
    /// Reads, moves and stops the gripper, holds its lease, changes its settings and acknowledges.
    Operator,
    /// Does all that, takes leases by force, sends raw requests in the device's protocol, tests webhooks, and reloads
    /// the configuration.
    Supervisor,
}

/// The right that an operation requires.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, strum::VariantArray)]
pub enum Right {
    /// Triggers a FAST STOP.
    FastStop,
    /// Stops a motion.
    Stop,
    /// Only reads.
    Read,
    /// Moves a gripper or changes something.
    Operate,
    /// Overrides other clients, or bypasses the checks of the typed operations.
    Supervise,
}

impl Role {
    #[must_use]
    pub const fn has(self, right: Right) -> bool {
        match right {
            Right::FastStop => true,
            Right::Stop => matches!(self, Self::Stop | Self::Operator | Self::Supervisor),
            Right::Read => !matches!(self, Self::Stop),
            Right::Operate => matches!(self, Self::Operator | Self::Supervisor),
            Right::Supervise => matches!(self, Self::Supervisor),
        }
    }
}

impl Right {
    /// The lowest role with this right.
    #[must_use]
    pub const fn role(self) -> Role {
        match self {
            Self::FastStop | Self::Stop => Role::Stop,
            Self::Read => Role::Observer,
            Self::Operate => Role::Operator,
            Self::Supervise => Role::Supervisor,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_have_their_rights() {
        let rights = |role: Role| Right::VARIANTS.iter().copied().filter(|right| role.has(*right)).collect::<Vec<_>>();
        assert_eq!(rights(Role::Stop), [Right::FastStop, Right::Stop]);
        assert_eq!(rights(Role::Observer), [Right::FastStop, Right::Read]);
        assert_eq!(rights(Role::Operator), [Right::FastStop, Right::Stop, Right::Read, Right::Operate]);
        assert_eq!(rights(Role::Supervisor), Right::VARIANTS);
        for right in Right::VARIANTS {
            assert!(right.role().has(*right), "{right:?}");
        }
    }
}
