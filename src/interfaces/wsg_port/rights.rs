//! Rights of the clients that the configuration knows by their addresses, and the limits that all clients may change.

use std::net::IpAddr;

use super::order::PortOrder;
use super::port::{LimitsPolicy, Port, Rules};
use super::refusals::Cause;
use crate::access::Right;
use crate::model::Action;
use crate::wsg::Command;

/// Checks whether a client may give an order. A FAST STOP, a read and the end of a lease need no right. The list of
/// allowed networks admits operators. A reload can change both for an open connection.
pub(super) fn check(port: &Port, client: IpAddr, order: &PortOrder) -> Result<(), Cause> {
    let right = match order {
        PortOrder::FastStop | PortOrder::Release => return Ok(()),
        PortOrder::Command(Action::Stop) => Right::Stop,
        PortOrder::Exchange(Command::Custom(custom)) if port.gripper.only_reads(custom.id()) => return Ok(()),
        PortOrder::Exchange(command) if command.is_read() => return Ok(()),
        PortOrder::Exchange(command) if !allows_limit(&port.rules, command) => return Err(Cause::Limits),
        _ => Right::Operate,
    };
    let is_allowed = match port.peers.identity(client) {
        Some(identity) => identity.may(right, Some(port.gripper.name())),
        None => port.peers.allows(client),
    };
    if is_allowed { Ok(()) } else { Err(Cause::Forbidden) }
}

/// Whether clients may send a command that changes a limit. Overdrive Mode can always be switched off.
fn allows_limit(rules: &Rules, command: &Command) -> bool {
    match command {
        _ if rules.limits == LimitsPolicy::Open => true,
        Command::SetForceLimit(force) => rules.max_force_n.is_some_and(|max_force_n| force.n() <= max_force_n),
        Command::SetSoftLimits(_) | Command::ClearSoftLimits => false,
        Command::OverdriveMode { on } => !on,
        _ => true,
    }
}
