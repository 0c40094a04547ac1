//! The WSG ports: bound before any gripper is connected, and served until the grippers are released.

use std::sync::Arc;

use tokio::runtime::Handle as RuntimeHandle;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::listen;
use crate::access::Access;
use crate::config::{Config, ConfigPlace};
use crate::connections::metrics::WsgPortMetrics;
use crate::gripper::Grippers;
use crate::interfaces::wsg_port::{self, ListenAddress, Listener, Port, Rules};
use crate::model::Name;
use crate::operations::calls::audit::Audit;

/// A bound port that is not served yet.
pub(super) struct BoundPort {
    pub(super) listener: Listener,
    configured: ConfiguredPort,
    /// Descriptors for the port's TCP clients.
    descriptors: usize,
}

/// The configuration of one port.
#[derive(Debug, Clone, PartialEq)]
struct ConfiguredPort {
    gripper: Name,
    address: ListenAddress,
    rules: Rules,
}

/// A served port.
struct ServedPort {
    configured: ConfiguredPort,
    descriptors: usize,
    draining: CancellationToken,
    closing: CancellationToken,
    /// Returns the socket, for a port with other rules.
    task: JoinHandle<std::io::Result<Option<Listener>>>,
}

/// All served ports.
pub(super) struct Ports {
    served: Vec<ServedPort>,
    grippers: Grippers,
    context: PortContext,
}

/// The parts of the gateway that all ports use.
pub(super) struct PortContext {
    /// The grippers' runtime, so that a Loop to a gripper and back needs no change of threads, unlike Modbus. The work of
    /// each turn is bounded, and the FAST STOPs of a client are combined: 120 connections that flood one port with them
    /// delay a FAST STOP of another gripper by some 40 ms at most (`tests/attacks/long/crowded_ports.rs`).
    pub(super) devices: RuntimeHandle,
    pub(super) audit: Arc<Audit>,
    pub(super) access: Arc<Access>,
    pub(super) metrics: WsgPortMetrics,
    pub(super) draining: CancellationToken,
    pub(super) closing: CancellationToken,
}

/// The new ports of a configuration.
pub(super) struct PortChanges {
    configured: Vec<ConfiguredPort>,
    bound: Vec<BoundPort>,
}

/// Binds all ports. `descriptors` is the share of each port's TCP clients.
pub(super) fn bind(config: &Config, descriptors: usize) -> anyhow::Result<Vec<BoundPort>> {
    configured(config).into_iter().map(|(port, place)| BoundPort::bind(port, place, descriptors)).collect()
}

fn configured(config: &Config) -> Vec<(ConfiguredPort, &ConfigPlace)> {
    let mut ports = Vec::new();
    for gripper in &config.grippers {
        for (address, place) in &gripper.wsg_port.addresses {
            let rules = gripper.wsg_port.rules.clone();
            ports.push((ConfiguredPort { gripper: gripper.name.clone(), address: *address, rules }, place));
        }
    }
    ports
}

impl ConfiguredPort {
    /// Whether both use the same socket. Each gripper has its own where the system chooses the port.
    fn is_same_socket(&self, other: &Self) -> bool {
        let can_be = self.gripper == other.gripper || !self.address.is_any_port();
        can_be && self.address.is_same_socket(&other.address)
    }
}

impl BoundPort {
    pub(super) fn gripper(&self) -> &Name {
        &self.configured.gripper
    }

    fn bind(configured: ConfiguredPort, place: &ConfigPlace, descriptors: usize) -> anyhow::Result<Self> {
        let ConfiguredPort { gripper, address, .. } = &configured;
        let listener = Listener::bind(*address).map_err(|error| {
            listen::failed(format_args!("{place}: the WSG port of {gripper} cannot listen on {address}"), error)
        })?;
        Ok(Self { listener, configured, descriptors })
    }
}

impl Ports {
    pub(super) fn serve(ports: Vec<BoundPort>, grippers: Grippers, context: PortContext) -> Self {
        let mut this = Self { served: Vec::new(), grippers, context };
        for port in ports {
            this.start(port);
        }
        this
    }

    fn start(&mut self, BoundPort { listener, configured, descriptors }: BoundPort) {
        let Some(handle) = self.grippers.get(&configured.gripper) else { return };
        let PortContext { devices, audit, access, metrics, draining, closing } = &self.context;
        metrics.serves(configured.gripper.as_str());
        let parts = (audit.clone(), access.clone(), metrics.clone());
        let port = Port::new(handle, configured.rules.clone(), descriptors, parts);
        let draining = draining.child_token();
        let closing = closing.child_token();
        let task = devices.spawn(wsg_port::serve(port, listener, draining.clone(), closing.clone()));
        self.served.push(ServedPort { configured, descriptors, draining, closing, task });
    }

    /// Binds the ports of a configuration that are not served yet.
    pub(super) fn prepare(&self, config: &Config, descriptors: usize) -> anyhow::Result<PortChanges> {
        let mut changes = PortChanges { configured: Vec::new(), bound: Vec::new() };
        for (port, place) in configured(config) {
            if !self.served.iter().any(|served| served.configured.is_same_socket(&port)) {
                changes.bound.push(BoundPort::bind(port.clone(), place, descriptors)?);
            }
            changes.configured.push(port);
        }
        Ok(changes)
    }

    /// Ends the ports that the new configuration does not have, or has with other rules. Their clients lose their
    /// connections; ports of these grippers end too. A client that is moving a gripper counts as lost.
    pub(super) async fn end_changed(&mut self, changes: &PortChanges, grippers: &[Name]) -> Vec<BoundPort> {
        let mut ended = Vec::new();
        for port in std::mem::take(&mut self.served) {
            if changes.configured.contains(&port.configured) && !grippers.contains(&port.configured.gripper) {
                self.served.push(port);
            } else {
                ended.push(port);
            }
        }
        let mut free = Vec::new();
        for ServedPort { configured, descriptors, draining, closing, task } in ended {
            // `closing` comes first, so that the port returns its socket.
            closing.cancel();
            draining.cancel();
            let ended = task.await.map_err(std::io::Error::other).flatten();
            let listener = ended.and_then(|listener| listener.ok_or_else(|| std::io::Error::other("socket closed")));
            let next = changes.configured.iter().find(|port| port.is_same_socket(&configured));
            match (listener, next.cloned()) {
                (Ok(listener), Some(configured)) => {
                    let listener = listener.with_settings_of(configured.address);
                    free.push(BoundPort { listener, configured, descriptors });
                }
                (Err(error), _) => tracing::error!(gripper = %configured.gripper, %error, "WSG port failed"),
                (Ok(_), None) => {}
            }
        }
        free
    }

    /// Serves the new ports, and those that have other rules now.
    pub(super) fn start_changed(&mut self, free: Vec<BoundPort>, changes: PortChanges) {
        for port in free.into_iter().chain(changes.bound) {
            self.start(port);
        }
    }

    /// Stops listening, and waits for the end of all clients.
    pub(super) async fn ended(self) -> std::io::Result<()> {
        for ended in futures_util::future::join_all(self.served.into_iter().map(|port| port.task)).await {
            ended.map_err(std::io::Error::other)??;
        }
        Ok(())
    }
}
