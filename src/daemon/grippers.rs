//! The grippers of a configuration: started, changed and removed.

use std::collections::BTreeMap;
use std::sync::Arc;

use prometheus::Registry;
use rand::RngExt as _;
use tokio::runtime::Handle as RuntimeHandle;

use super::simulation::SimulatedDevice;
use crate::config::{Config, ConfigError, DeviceSource, GripperConfig};
use crate::gripper::actor::ActorConfig;
use crate::gripper::metrics::{Newest, Registration};
use crate::gripper::recorder::RestoredState;
use crate::gripper::{self, Connector, GripperMetrics, Grippers, Handle, Reconfiguration};
use crate::journal::{Journal, Recovered};
use crate::model::{Name, PersistedKey};
use crate::transport::DevicesInUse;

/// The running grippers.
pub(super) struct RunningGrippers {
    pub(super) grippers: Grippers,
    devices: RuntimeHandle,
    journal: Journal,
    registry: Registry,
    running: BTreeMap<Name, RunningGripper>,
    in_use: DevicesInUse,
}

/// The parts of a running gripper that a new configuration uses.
struct RunningGripper {
    connector: Arc<dyn Connector>,
    metrics: GripperMetrics,
    _newest: Registration,
}

/// The difference between two configurations of grippers.
#[derive(Default)]
pub(super) struct GripperDifferences {
    pub(super) added: Vec<Name>,
    pub(super) removed: Vec<Name>,
    /// Grippers with another configuration.
    pub(super) changed: Vec<Name>,
    /// Grippers of `changed` whose WSG ports have to end, because their clients depend on what has changed.
    pub(super) ending_ports: Vec<Name>,
    /// New devices of added and changed grippers.
    connectors: BTreeMap<Name, Arc<dyn Connector>>,
}

impl RunningGrippers {
    /// Starts the grippers of a configuration.
    pub(super) fn start(
        config: &Config,
        devices: &RuntimeHandle,
        journal: &Journal,
        recovered: &Recovered,
        registry: &Registry,
    ) -> anyhow::Result<Self> {
        let grippers = Grippers::new([]);
        let devices = devices.clone();
        let journal = journal.clone();
        let registry = registry.clone();
        let in_use = DevicesInUse::default();
        let mut this = Self { grippers, devices, journal, registry, running: BTreeMap::new(), in_use };
        let mut handles = Vec::new();
        for gripper in &config.grippers {
            let connector = this.connector(gripper)?;
            handles.push(this.spawn(config, gripper, connector, recovered)?);
        }
        this.grippers.change(handles, &[]);
        Ok(this)
    }

    /// Compares two configurations, and prepares the devices of the new one.
    pub(super) fn compare(&self, before: &Config, after: &Config) -> Result<GripperDifferences, ConfigError> {
        let mut changes = GripperDifferences::default();
        for gripper in &before.grippers {
            if find(after, &gripper.name).is_none() {
                changes.removed.push(gripper.name.clone());
            }
        }
        for gripper in &after.grippers {
            let name = gripper.name.clone();
            let old = find(before, &name);
            if old.is_none_or(|old| old.device != gripper.device) {
                // Added grippers start after the others have left their devices.
                if old.is_some() {
                    check_device(gripper, before, &changes.removed)?;
                }
                changes.connectors.insert(name.clone(), self.connector(gripper)?);
            }
            match old {
                None => changes.added.push(name),
                Some(old) if !is_same(old, gripper) => {
                    if ends_ports(old, gripper) {
                        changes.ending_ports.push(name.clone());
                    }
                    changes.changed.push(name);
                }
                Some(_) => {}
            }
        }
        Ok(changes)
    }

    /// Applies the changes. Removed grippers are drained first, since an added one can have the same device. Until then
    /// they take FAST STOPs.
    pub(super) async fn apply(
        &mut self,
        config: &Config,
        mut changes: GripperDifferences,
        recovered: &Recovered,
    ) -> anyhow::Result<()> {
        let leaving: Vec<_> = changes.removed.iter().filter_map(|name| self.grippers.get(name)).collect();
        futures_util::future::join_all(leaving.iter().map(Handle::drain)).await;
        self.grippers.change([], &changes.removed);
        for name in &changes.removed {
            self.running.remove(name);
        }
        let mut changing = Vec::new();
        for gripper in config.grippers.iter().filter(|gripper| changes.changed.contains(&gripper.name)) {
            let (Some(handle), Some(running)) = (self.grippers.get(&gripper.name), self.running.get_mut(&gripper.name))
            else {
                continue;
            };
            let connector = changes.connectors.remove(&gripper.name);
            if let Some(connector) = &connector {
                running.connector = connector.clone();
            }
            let config = actor_config(config, gripper, &*running.connector, running.metrics.clone());
            changing.push(async move { handle.reconfigure(Reconfiguration { config, connector }).await });
        }
        futures_util::future::join_all(changing).await;
        // The connectors that remain belong to added grippers.
        for gripper in &config.grippers {
            if let Some(connector) = changes.connectors.remove(&gripper.name) {
                let handle = self.spawn(config, gripper, connector, recovered)?;
                self.grippers.change([handle], &[]);
            }
        }
        Ok(())
    }

    fn connector(&self, gripper: &GripperConfig) -> Result<Arc<dyn Connector>, ConfigError> {
        Ok(match &gripper.device {
            DeviceSource::At(address) => Arc::new(self.in_use.exclusive(gripper.name.as_str(), address.clone())),
            DeviceSource::Simulated(url) => {
                let device =
                    SimulatedDevice::from_url(url).map_err(|detail| ConfigError::at(&gripper.place, detail))?;
                Arc::new(device.start(url.as_str()))
            }
        })
    }

    fn spawn(
        &mut self,
        config: &Config,
        gripper: &GripperConfig,
        connector: Arc<dyn Connector>,
        recovered: &Recovered,
    ) -> anyhow::Result<Handle> {
        let _inside = self.devices.enter();
        let metrics = GripperMetrics::register(&self.registry, &gripper.name)?;
        let actor = actor_config(config, gripper, &*connector, metrics.clone());
        let recorder = Arc::new(self.journal.clone());
        let handle = gripper::spawn(actor, connector.clone(), recorder, restored(recovered, gripper));
        let newest = Newest::register(&self.registry, &handle)?;
        self.running.insert(gripper.name.clone(), RunningGripper { connector, metrics, _newest: newest });
        Ok(handle)
    }
}

fn find<'a>(config: &'a Config, name: &Name) -> Option<&'a GripperConfig> {
    config.grippers.iter().find(|gripper| gripper.name == *name)
}

/// Checks that no other gripper that stays has a changed gripper's new device. Both would change at the same time, and
/// be connected to one device.
fn check_device(gripper: &GripperConfig, before: &Config, removed: &[Name]) -> Result<(), ConfigError> {
    let DeviceSource::At(address) = &gripper.device else { return Ok(()) };
    for other in &before.grippers {
        if other.name == gripper.name || removed.contains(&other.name) {
            continue;
        }
        let DeviceSource::At(used) = &other.device else { continue };
        if address.conflict_with(used).is_some() {
            let name = &gripper.name;
            let other = &other.name;
            let detail = format!(
                "{name} cannot use {address} yet, because {other} uses that device until this reload: restart the \
                 gateway, or first remove {other} and reload"
            );
            return Err(ConfigError::at(&gripper.place, detail));
        }
    }
    Ok(())
}

/// Whether a gripper keeps its configuration, wherever that stands in the file. WSG ports are compared separately.
fn is_same(before: &GripperConfig, after: &GripperConfig) -> bool {
    let wsg_port = after.wsg_port.clone();
    let place = after.place.clone();
    GripperConfig { wsg_port, place, ..before.clone() } == *after
}

/// Whether what the clients of its WSG ports depend on differs: the device, and what a port copies for each client.
fn ends_ports(before: &GripperConfig, after: &GripperConfig) -> bool {
    let old = &before.rules;
    let new = &after.rules;
    before.device != after.device
        || old.updates != new.updates
        || old.custom_ids.read != new.custom_ids.read
        || old.custom_ids.stream != new.custom_ids.stream
        || old.fast_stop_on_disconnect != new.fast_stop_on_disconnect
}

fn actor_config(
    config: &Config,
    gripper: &GripperConfig,
    connector: &dyn Connector,
    metrics: GripperMetrics,
) -> ActorConfig {
    ActorConfig {
        gateway: config.name.clone(),
        name: gripper.name.clone(),
        url: connector.url(),
        properties: connector.properties(),
        rules: gripper.rules.clone(),
        seed: rand::rng().random(),
        metrics,
    }
}

/// Returns the journal's knowledge of a gripper from earlier runs.
fn restored(recovered: &Recovered, gripper: &GripperConfig) -> RestoredState {
    let requests = recovered.requests.iter().filter(|request| request.command.gripper == gripper.name);
    RestoredState {
        settings: persisted(recovered, &gripper.name, PersistedKey::Settings),
        latch: persisted(recovered, &gripper.name, PersistedKey::Latch),
        lease: persisted(recovered, &gripper.name, PersistedKey::Lease),
        holding: persisted(recovered, &gripper.name, PersistedKey::Holding),
        last_command: persisted(recovered, &gripper.name, PersistedKey::LastCommand),
        requests: requests.cloned().collect(),
        unclean: recovered.unclean,
        unknown_past: recovered.unknown_past.clone(),
    }
}

fn persisted(recovered: &Recovered, gripper: &Name, key: PersistedKey) -> Option<String> {
    let memory = recovered.memory.iter().find(|memory| memory.gripper == *gripper && memory.key == key);
    memory.and_then(|memory| memory.value.clone())
}
