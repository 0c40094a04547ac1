//! Rights of the clients that the configuration knows by their addresses.

use std::net::IpAddr;

use super::device::PortOrder;
use super::port::Port;
use crate::access::Right;
use crate::gripper::model::Action;
use crate::wsg::Command;

/// Whether a client's role allows an order. A FAST STOP, a read and the end of a lease need none. The list of allowed
/// networks admits operators. A reload can change both for an open connection.
pub(super) fn allows(port: &Port, client: IpAddr, order: &PortOrder) -> bool {
    let right = match order {
        PortOrder::FastStop | PortOrder::Release => return true,
        PortOrder::Command(Action::Stop) => Right::Stop,
        PortOrder::Exchange(Command::Custom(custom)) if port.gripper.only_reads(custom.id()) => return true,
        PortOrder::Exchange(command) if command.is_read() => return true,
        _ => Right::Operate,
    };
    match port.peers.identity(client) {
        Some(identity) => identity.may(right, Some(port.gripper.name())),
        None => port.peers.allows(client),
    }
}
