//! Reading the configuration again while the gateway runs: all of it is prepared before any of it is applied.

use std::net::SocketAddr;
use std::sync::Arc;

use tokio::net::TcpListener;
use tokio::runtime::Handle as RuntimeHandle;
use tokio::signal::unix::Signal;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use super::descriptors::Shares;
use super::grippers::{GripperDifferences, RunningGrippers};
use super::mdns::Announcement;
use super::modbus::ServedModbus;
use super::ports::{PortChanges, Ports};
use super::{listen, settings, systemd};
use crate::access::{Access, AccessRules};
use crate::config::{AccessConfig, Config, ConfigError, ConfigPlace, Flags, GripperConfig};
use crate::gripper::Now;
use crate::gripper::model::{Client, Detail, Event, GatewayEvent, Name};
use crate::gripper::recorder::{Record, Recorder as _};
use crate::interfaces::http::{self, HttpSettings, SharedSettings};
use crate::journal::{Journal, Recovered};
use crate::operations::ReloadRequest;
use crate::wear::Wear;

/// The parts of the gateway that a reload changes.
pub(super) struct Reloader {
    pub(super) flags: Flags,
    pub(super) config: Config,
    pub(super) shares: Shares,
    pub(super) journal: Journal,
    pub(super) access: Arc<Access>,
    pub(super) settings: SharedSettings,
    pub(super) wear: Arc<Wear>,
    pub(super) listener: watch::Sender<Arc<TcpListener>>,
    /// `None` if the gateway is not announced by mDNS.
    pub(super) announcement: Option<Announcement>,
    /// The runtime that accepts connections.
    pub(super) accept: RuntimeHandle,
    pub(super) grippers: RunningGrippers,
    pub(super) ports: Ports,
    /// `None` if Modbus is off.
    pub(super) modbus: Option<ServedModbus>,
}

/// Everything that a new configuration needs. Applying it fails only on internal errors.
struct Prepared {
    config: Config,
    access: AccessRules,
    settings: HttpSettings,
    /// `None` if the address stays.
    listener: Option<TcpListener>,
    grippers: GripperDifferences,
    /// The journal's knowledge of added grippers.
    recovered: Recovered,
    ports: PortChanges,
    /// Descriptors for the clients of each new WSG port.
    of_a_port: usize,
    changes: Vec<String>,
}

/// Reason why a reload failed, with the remedy. Only [`Self::Partial`] leaves changes behind.
#[derive(Debug, thiserror::Error)]
enum ReloadError {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error("{} cannot change while the gateway runs: restart it", .0.join(", "))]
    NeedsRestart(Vec<&'static str>),
    #[error("{0:#}")]
    Unusable(anyhow::Error),
    #[error("new configuration applied only in part ({0:#}): restart the gateway")]
    Partial(anyhow::Error),
}

impl Reloader {
    /// Reloads on request and on SIGHUP, until the gateway stops.
    pub(super) async fn run(
        mut self,
        mut requests: mpsc::Receiver<ReloadRequest>,
        mut hang_up: Signal,
        stopping: CancellationToken,
    ) -> Self {
        loop {
            let request = tokio::select! {
                biased;
                () = stopping.cancelled() => return self,
                Some(request) = requests.recv() => Some(request),
                Some(()) = hang_up.recv() => None,
                else => return self,
            };
            systemd::reloading();
            let (client, answer) = request.map(|request| (request.client, request.answer)).unzip();
            let result = self.reload(client.as_ref()).await.map_err(|error| error.to_string());
            match &result {
                Ok(changes) => tracing::info!(changes = changes.join("; "), "configuration reloaded"),
                Err(error) => tracing::error!(error, "configuration not reloaded"),
            }
            systemd::ready();
            if let Some(answer) = answer {
                // The client may be gone.
                let _ = answer.send(result);
            }
        }
    }

    async fn reload(&mut self, client: Option<&Client>) -> Result<Vec<String>, ReloadError> {
        let prepared = self.prepare().await?;
        let changes = prepared.changes.clone();
        // With the same configuration, the files that it names can still be new.
        self.apply(prepared).await.map_err(ReloadError::Partial)?;
        settings::log_warnings(&self.config);
        if !changes.is_empty() {
            let detail = Detail::Gateway(GatewayEvent::Reloaded { changes: changes.clone() });
            let event = Event::new(Now::read().wall, None, detail);
            let event = client.map_or_else(|| event.clone(), |client| event.clone().by(client));
            self.journal.record(Record::Event(event, None));
        }
        Ok(changes)
    }

    async fn prepare(&self) -> Result<Prepared, ReloadError> {
        let flags = self.flags.clone();
        // Reading files can block.
        let loaded = tokio::task::spawn_blocking(move || {
            Config::load(&flags).and_then(|config| super::check(&config).map(|()| config))
        });
        let config = loaded.await.map_err(|error| ReloadError::Unusable(error.into()))??;
        let mut fixed = fixed(&self.config, &config);
        // A program must not find another gripper at the same unit.
        if self.modbus.as_ref().is_some_and(|modbus| modbus.has_other_units(&config)) {
            fixed.push("the Modbus units of grippers");
        }
        if !fixed.is_empty() {
            return Err(ReloadError::NeedsRestart(fixed));
        }
        let unusable = ReloadError::Unusable;
        let of_a_port = self.shares.of_ports(&config).map_err(|error| unusable(error.into()))?;
        let settings = settings::of_http(&config, self.settings.get().tls.clone()).map_err(unusable)?;
        let access = settings::of_access(&config).map_err(|error| unusable(error.into()))?;
        let grippers = self.grippers.compare(&self.config, &config)?;
        let ports = self.ports.prepare(&config, of_a_port).map_err(unusable)?;
        let listener =
            (config.listen != self.config.listen).then(|| self.listen(&config)).transpose().map_err(unusable)?;
        let recovered = if grippers.added.is_empty() {
            Recovered::default()
        } else {
            self.journal.recall().await.map_err(|error| unusable(error.into()))?
        };
        let changes = differences(&self.config, &config, &grippers);
        Ok(Prepared { config, access, settings, listener, grippers, recovered, ports, of_a_port, changes })
    }

    fn listen(&self, config: &Config) -> anyhow::Result<TcpListener> {
        let _inside = self.accept.enter();
        http::listen(config.listen)
            .map_err(|error| listen::failed(format_args!("cannot listen on {} (listen)", config.listen), error))
    }

    async fn apply(&mut self, prepared: Prepared) -> anyhow::Result<()> {
        let Prepared { config, access, settings, listener, grippers, recovered, ports, of_a_port, .. } = prepared;
        self.shares.wsg_port = self.shares.wsg_port.max(of_a_port);
        self.access.replace(access);
        self.settings.replace(settings);
        self.wear.set_limits(config.drift);
        if let Some(listener) = listener {
            self.listener.send_replace(Arc::new(listener));
        }
        let affected: Vec<Name> = [&grippers.removed, &grippers.ending_ports].into_iter().flatten().cloned().collect();
        // The ports take FAST STOPs until the grippers are released.
        self.grippers.apply(&config, grippers, &recovered).await?;
        let free = self.ports.end_changed(&ports, &affected).await;
        self.ports.start_changed(free, ports);
        if let Some(modbus) = &mut self.modbus {
            modbus.reconfigure(&config, &self.access);
        }
        let announced = |config: &Config| (config.mdns, config.listen);
        let is_missing = config.mdns && self.announcement.is_none();
        if is_missing || announced(&config) != announced(&self.config) {
            if let Some(before) = self.announcement.take() {
                before.withdraw().await;
            }
            let address = self.listener.borrow().local_addr()?;
            self.announcement = Announcement::of(&config, address);
        }
        self.config = config;
        Ok(())
    }
}

/// Returns the settings that differ and cannot change while the gateway runs.
fn fixed(before: &Config, after: &Config) -> Vec<&'static str> {
    let is_guarded = |config: &Config| config.access != AccessConfig::Open;
    let has_defaults = |config: &Config| config.grippers.iter().any(|gripper| gripper.place == ConfigPlace::Default);
    let journal = |config: &Config| (config.journal.place.clone(), config.journal.max_age, config.journal.max_bytes);
    let differs = [
        ("name", before.name != after.name),
        ("the journal's path and limits", journal(before) != journal(after)),
        ("public_url", before.public_url != after.public_url),
        ("modbus", modbus_address(before) != modbus_address(after)),
        ("zenoh", before.zenoh != after.zenoh),
        ("webhooks", before.webhooks != after.webhooks),
        // Open connections began under the other rule.
        ("whether clients need credentials", is_guarded(before) != is_guarded(after)),
        ("whether connections are encrypted", before.tls.is_some() != after.tls.is_some()),
        // An empty file, e.g. while an editor writes it, stands for simulated grippers.
        ("the configured grippers (the new file names none)", !has_defaults(before) && has_defaults(after)),
    ];
    differs.into_iter().filter(|(_, differs)| *differs).map(|(name, _)| name).collect()
}

/// Whether the settings of Modbus differ, wherever they stand in the file.
fn has_other_modbus(before: &Config, after: &Config) -> bool {
    let settings = |config: &Config| config.modbus.as_ref().map(|modbus| (modbus.allow.clone(), modbus.heartbeat));
    settings(before) != settings(after) || before.modbus.is_some() && before.modbus_units() != after.modbus_units()
}

fn modbus_address(config: &Config) -> Option<SocketAddr> {
    config.modbus.as_ref().map(|modbus| modbus.address)
}

/// Describes the changes in words.
fn differences(before: &Config, after: &Config, grippers: &GripperDifferences) -> Vec<String> {
    let of_grippers = |names: &[Name], change: &'static str| {
        names.iter().map(move |name| format!("gripper {name}: {change}")).collect::<Vec<_>>()
    };
    let mut changes = of_grippers(&grippers.removed, "removed");
    changes.extend(of_grippers(&grippers.added, "added"));
    changes.extend(of_grippers(&grippers.changed, "changed"));
    let has_other_ports = |gripper: &&GripperConfig| {
        let old = before.grippers.iter().find(|old| old.name == gripper.name);
        old.is_some_and(|old| !old.wsg_port.is_same(&gripper.wsg_port))
    };
    let with_other_ports: Vec<_> =
        after.grippers.iter().filter(has_other_ports).map(|gripper| gripper.name.clone()).collect();
    changes.extend(of_grippers(&with_other_ports, "WSG port changed"));
    let differs = [
        ("listen", before.listen != after.listen),
        ("hosts", before.hosts != after.hosts),
        ("cors_origins", before.cors_origins != after.cors_origins),
        ("frame_ancestors", before.frame_ancestors != after.frame_ancestors),
        ("Modbus", has_other_modbus(before, after)),
        ("idle_timeout_s", before.idle_timeout != after.idle_timeout),
        ("drift", before.drift != after.drift),
        ("mdns", before.mdns != after.mdns),
        ("access and clients", before.access != after.access),
        ("tls", before.tls != after.tls),
    ];
    let others = differs.into_iter().filter(|(_, differs)| *differs);
    changes.extend(others.map(|(name, _)| format!("{name}: changed")));
    changes
}
