//! The WSG ports: bound before any gripper is connected, and served until the grippers are released.

use std::sync::Arc;

use tokio::runtime::Runtime;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use super::listen;
use crate::config::{AcknowledgePolicy, Config, WsgAddress, WsgPort};
use crate::gripper::Grippers;
use crate::gripper::model::Name;
use crate::interfaces::metrics::WsgPortMetrics;
use crate::interfaces::wsg_port::{self, Datagrams, LOST_AFTER, ListenAddress, Listener, Port, Rules};
use crate::operations::audit::Audit;

/// A bound port that is not served yet.
pub(super) struct Bound {
    pub(super) gripper: Name,
    pub(super) listener: Listener,
    rules: Rules,
    /// Descriptors for the port's TCP clients.
    descriptors: usize,
}

/// Binds all ports. `descriptors` is the share of each port's TCP clients.
pub(super) fn bind(config: &Config, descriptors: usize) -> anyhow::Result<Vec<Bound>> {
    let mut ports = Vec::new();
    for gripper in &config.grippers {
        for (address, place) in &gripper.wsg_port.addresses {
            let address = match *address {
                WsgAddress::Tcp(address) => ListenAddress::Tcp(address),
                WsgAddress::Udp { address, reply_port, lost_after } => {
                    ListenAddress::Udp(address, Datagrams { reply_port, lost_after: lost_after.unwrap_or(LOST_AFTER) })
                }
            };
            let listener = Listener::bind(address).map_err(|error| {
                let name = &gripper.name;
                listen::failed(format_args!("{place}: the WSG port of {name} cannot listen on {address}"), error)
            })?;
            ports.push(Bound { gripper: gripper.name.clone(), listener, rules: rules(&gripper.wsg_port), descriptors });
        }
    }
    Ok(ports)
}

/// Serves the ports on the grippers' runtime, so that a Loop to a gripper and back needs no change of threads. The
/// ports have few clients, and the work of each turn is bounded.
pub(super) fn serve(
    devices: &Runtime,
    ports: Vec<Bound>,
    fleet: &Grippers,
    audit: &Arc<Audit>,
    metrics: &WsgPortMetrics,
    draining: &CancellationToken,
    closing: &CancellationToken,
) -> JoinSet<std::io::Result<()>> {
    let mut served = JoinSet::new();
    for Bound { gripper, listener, rules, descriptors } in ports {
        let Some(handle) = fleet.get(&gripper) else { continue };
        metrics.serves(gripper.as_str());
        let port = Port::new(handle.clone(), rules, descriptors, audit.clone(), metrics.clone());
        served.spawn_on(wsg_port::serve(port, listener, draining.clone(), closing.clone()), devices.handle());
    }
    served
}

fn rules(configured: &WsgPort) -> Rules {
    Rules {
        checksum_evaluation: configured.checksum_evaluation,
        acknowledge_any: configured.acknowledge == AcknowledgePolicy::Any,
        allow: configured.allow.clone(),
    }
}
