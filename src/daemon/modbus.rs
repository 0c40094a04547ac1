//! Modbus TCP: bound before any gripper is connected, and served until the grippers are released.

use std::collections::BTreeMap;
use std::sync::Arc;

use tokio::runtime::Handle as RuntimeHandle;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::listen;
use crate::access::Access;
use crate::config::Config;
use crate::connections;
use crate::connections::foreign::ForeignClients;
use crate::connections::metrics::InterfaceMetrics;
use crate::connections::peers::KnownPeers;
use crate::interfaces::http::HttpContext;
use crate::interfaces::modbus::{self, ModbusContext, ModbusSettings};
use crate::model::Name;

/// A bound listener that is not served yet.
pub(super) struct BoundModbus {
    listener: std::net::TcpListener,
    /// Descriptors for its clients.
    descriptors: usize,
}

/// The running Modbus server.
pub(super) struct ServedModbus {
    settings: watch::Sender<Arc<ModbusSettings>>,
    /// Every gripper that a unit identifier has stood for.
    assigned: BTreeMap<u8, Name>,
    task: JoinHandle<std::io::Result<()>>,
}

/// Binds the listener; `None` if Modbus is off.
pub(super) fn bind(config: &Config, descriptors: usize) -> anyhow::Result<Option<BoundModbus>> {
    let Some(modbus) = &config.modbus else { return Ok(None) };
    let listener = connections::listen(modbus.address).map_err(|error| {
        listen::failed(format_args!("{}: Modbus cannot listen on {}", modbus.place, modbus.address), error)
    })?;
    Ok(Some(BoundModbus { listener, descriptors }))
}

/// Returns the settings that a reload can change; `None` if Modbus is off.
fn settings(config: &Config, access: &Arc<Access>) -> Option<ModbusSettings> {
    let modbus = config.modbus.as_ref()?;
    let peers = KnownPeers::new(modbus.rules.allow.clone(), access.clone());
    Some(ModbusSettings { peers, heartbeat: modbus.rules.heartbeat, units: config.modbus_units() })
}

impl BoundModbus {
    /// Returns the address, for the announcement.
    pub(super) fn address(&self) -> std::io::Result<std::net::SocketAddr> {
        self.listener.local_addr()
    }

    /// Serves Modbus on a runtime of its own, so that no flood of its requests takes time from the grippers or delays a
    /// FAST STOP of another interface.
    pub(super) fn serve(
        self,
        config: &Config,
        context: &HttpContext,
        runtime: &RuntimeHandle,
        tokens: (CancellationToken, CancellationToken),
    ) -> anyhow::Result<Option<ServedModbus>> {
        let Some(settings) = settings(config, &context.gateway.access) else { return Ok(None) };
        let (settings, settings_now) = watch::channel(Arc::new(settings));
        let assigned = config.modbus_units();
        let metrics = InterfaceMetrics::register(&context.registry, "modbus")?;
        let foreign = ForeignClients::register(&context.registry, "modbus", "Modbus TCP")?;
        let context = ModbusContext::new(context.gateway.clone(), metrics, foreign);
        let task = runtime.spawn(modbus::serve(context, (self.listener, self.descriptors), settings_now, tokens));
        Ok(Some(ServedModbus { settings, assigned, task }))
    }
}

impl ServedModbus {
    /// Whether a unit identifier would address another gripper than before.
    pub(super) fn has_other_units(&self, config: &Config) -> bool {
        config.modbus_units().iter().any(|(unit, name)| self.assigned.get(unit).is_some_and(|former| former != name))
    }

    /// Applies a new configuration.
    pub(super) fn reconfigure(&mut self, config: &Config, access: &Arc<Access>) {
        if let Some(settings) = settings(config, access) {
            self.assigned.extend(config.modbus_units());
            self.settings.send_replace(Arc::new(settings));
        }
    }

    /// Waits until all connections have ended.
    pub(super) async fn ended(self) -> std::io::Result<()> {
        self.task.await.map_err(std::io::Error::other)?
    }
}
