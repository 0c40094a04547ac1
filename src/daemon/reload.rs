//! Reading the configuration again while the gateway runs: all of it is prepared before any of it is applied.

use std::collections::BTreeMap;
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
use super::{listen, reloadable_settings, systemd};
use crate::access::{Access, AccessRules};
use crate::config::{
    AccessConfig, Config, ConfigError, ConfigPlace, Flags, GripperConfig, JournalConfig, Modbus, ModbusRules,
};
use crate::gripper::Now;
use crate::gripper::recorder::{Record, Recorder as _};
use crate::interfaces::http::{self, HttpSettings, SharedSettings};
use crate::interfaces::mqtt::MqttRunner;
use crate::journal::{Journal, Recovered};
use crate::model::{Client, Detail, Event, GatewayEvent, Name};
use crate::operations::ReloadRequest;
use crate::settings::{Applied, SettingsGroup as _};
use crate::wear::Wear;
use crate::webhooks::{WebhookChanges, WebhookRunner, WebhookSettings};

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
    pub(super) webhooks: Arc<WebhookRunner>,
    pub(super) mqtt: Arc<MqttRunner>,
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
    webhooks: WebhookChanges,
    /// The journal's knowledge of added grippers and webhooks.
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
        reloadable_settings::log_warnings(&self.config);
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
        let differences = differences(&self.config, &config);
        let mut fixed = with(Applied::Restart, &differences);
        // A program must not find another gripper at the same unit.
        if self.modbus.as_ref().is_some_and(|modbus| modbus.has_other_units(&config)) {
            fixed.push("modbus_unit (another gripper had this unit)");
        }
        if !fixed.is_empty() {
            return Err(ReloadError::NeedsRestart(fixed));
        }
        let unusable = ReloadError::Unusable;
        let of_a_port = self.shares.of_ports(&config).map_err(|error| unusable(error.into()))?;
        let before = self.settings.get();
        let settings = reloadable_settings::of_http(&config, before.port, before.tls.clone()).map_err(unusable)?;
        let access = reloadable_settings::of_access(&config).map_err(|error| unusable(error.into()))?;
        let grippers = self.grippers.compare(&self.config, &config)?;
        let ports = self.ports.prepare(&config, of_a_port).map_err(unusable)?;
        let listener =
            (config.listen != self.config.listen).then(|| self.listen(&config)).transpose().map_err(unusable)?;
        let port = listener.as_ref().map(TcpListener::local_addr).transpose();
        let port = port.map_err(|error| unusable(error.into()))?.map_or(before.port, |address| address.port());
        let settings = HttpSettings { port, ..settings };
        let webhooks = self.webhooks.prepare(&config.webhooks).map_err(unusable)?;
        let are_known = self.config.webhooks == config.webhooks && self.config.mqtt == config.mqtt;
        let recovered = if grippers.added.is_empty() && are_known {
            Recovered::default()
        } else {
            self.journal.recall().await.map_err(|error| unusable(error.into()))?
        };
        let changes = describe(&self.config, &config, &with(Applied::Reload, &differences), &grippers);
        Ok(Prepared { config, access, settings, listener, grippers, webhooks, recovered, ports, of_a_port, changes })
    }

    fn listen(&self, config: &Config) -> anyhow::Result<TcpListener> {
        let _inside = self.accept.enter();
        http::listen(config.listen)
            .map_err(|error| listen::failed(format_args!("cannot listen on {} (listen)", config.listen), error))
    }

    async fn apply(&mut self, prepared: Prepared) -> anyhow::Result<()> {
        let Prepared { config, access, settings, listener, grippers, webhooks, recovered, ports, of_a_port, .. } =
            prepared;
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
        let is_missing = config.web.mdns && self.announcement.is_none();
        if is_missing || config.web.mdns != self.config.web.mdns || config.listen != self.config.listen {
            if let Some(before) = self.announcement.take() {
                before.withdraw().await;
            }
            let address = self.listener.borrow().local_addr()?;
            self.announcement = Announcement::of(&config, address);
        }
        self.webhooks.apply(webhooks, &recovered.memory).await?;
        // Its future is large, and a reload is rare.
        Box::pin(self.mqtt.apply(config.mqtt.clone(), &recovered.memory)).await?;
        self.config = config;
        Ok(())
    }
}

/// Returns the keys and sections that differ, except for grippers and webhooks, which have names. A new field of
/// [`Config`] does not compile until this function compares it.
fn differences(before: &Config, after: &Config) -> Vec<(&'static str, Applied)> {
    use Applied::{Reload, Restart};
    let Config {
        name,
        listen,
        web,
        access,
        tls,
        drift,
        grippers,
        journal,
        modbus,
        zenoh,
        mqtt,
        tls_places: _,
        webhooks: _,
        warnings: _,
    } = before;
    let JournalConfig { place, max_age, max_bytes } = journal;
    let differs = [
        ("name", *name != after.name, Restart),
        ("journal", *place != after.journal.place, Restart),
        ("journal_max_age_days", *max_age != after.journal.max_age, Restart),
        ("journal_max_size_mb", *max_bytes != after.journal.max_bytes, Restart),
        ("modbus", modbus_address(modbus.as_ref()) != modbus_address(after.modbus.as_ref()), Restart),
        ("[zenoh]", *zenoh != after.zenoh, Restart),
        // Open connections began under the other rule.
        ("[access], or whether clients need credentials,", is_guarded(access) != is_guarded(&after.access), Restart),
        ("[tls], or whether connections are encrypted,", tls.is_some() != after.tls.is_some(), Restart),
        // An empty file, e.g. while an editor writes it, stands for simulated grippers.
        (
            "the configured grippers (the new file names none)",
            !has_defaults(grippers) && has_defaults(&after.grippers),
            Restart,
        ),
        ("listen", *listen != after.listen, Reload),
        ("Modbus", modbus_rules(before) != modbus_rules(after), Reload),
        ("mqtt", *mqtt != after.mqtt, Reload),
        ("drift", *drift != after.drift, Reload),
        ("access and clients", *access != after.access, Reload),
        ("tls", *tls != after.tls, Reload),
    ];
    let differs = differs.into_iter().filter(|(_, differs, _)| *differs).map(|(key, _, applied)| (key, applied));
    differs.chain(web.differences(&after.web)).collect()
}

fn modbus_address(modbus: Option<&Modbus>) -> Option<SocketAddr> {
    modbus.map(|modbus| modbus.address)
}

fn modbus_rules(config: &Config) -> Option<(&ModbusRules, BTreeMap<u8, Name>)> {
    config.modbus.as_ref().map(|modbus| (&modbus.rules, config.modbus_units()))
}

fn is_guarded(access: &AccessConfig) -> bool {
    *access != AccessConfig::Open
}

fn has_defaults(grippers: &[GripperConfig]) -> bool {
    grippers.iter().any(|gripper| gripper.place == ConfigPlace::Default)
}

fn with(applied: Applied, differences: &[(&'static str, Applied)]) -> Vec<&'static str> {
    differences.iter().filter(|(_, by)| *by == applied).map(|(key, _)| *key).collect()
}

/// Describes the changes in words.
fn describe(before: &Config, after: &Config, keys: &[&str], grippers: &GripperDifferences) -> Vec<String> {
    let mut changes = of_grippers(&grippers.removed, "removed");
    changes.extend(of_grippers(&grippers.added, "added"));
    changes.extend(of_grippers(&grippers.changed, "changed"));
    for gripper in &after.grippers {
        let old = before.grippers.iter().find(|old| old.name == gripper.name);
        if old.is_some_and(|old| !old.wsg_port.is_same(&gripper.wsg_port)) {
            changes.push(format!("gripper {}: WSG port changed", gripper.name));
        }
    }
    changes.extend(webhook_differences(&before.webhooks, &after.webhooks));
    changes.extend(keys.iter().map(|key| format!("{key}: changed")));
    changes
}

fn of_grippers(names: &[Name], change: &str) -> Vec<String> {
    names.iter().map(|name| format!("gripper {name}: {change}")).collect()
}

fn find_webhook<'a>(webhooks: &'a [WebhookSettings], name: &Name) -> Option<&'a WebhookSettings> {
    webhooks.iter().find(|webhook| webhook.name == *name)
}

fn webhook_differences(before: &[WebhookSettings], after: &[WebhookSettings]) -> Vec<String> {
    let gone = before.iter().filter(|webhook| find_webhook(after, &webhook.name).is_none());
    let mut changes: Vec<_> = gone.map(|webhook| format!("webhook {}: removed", webhook.name)).collect();
    for webhook in after {
        match find_webhook(before, &webhook.name) {
            None => changes.push(format!("webhook {}: added", webhook.name)),
            Some(old) if old != webhook => changes.push(format!("webhook {}: changed", webhook.name)),
            Some(_) => {}
        }
    }
    changes
}
