//! The composition root: builds everything, runs it, and shuts it down in order.

mod announce;
mod credentials;
mod descriptors;
mod grippers;
mod listen;
mod mdns;
mod metrics;
mod modbus;
mod ports;
mod reload;
mod reloadable_settings;
mod runtimes;
mod simulation;
mod systemd;

use std::future::Future;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use prometheus::Registry;
use tokio::net::TcpListener;
use tokio::runtime::{Builder, Handle, Runtime};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::{oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use url::Url;

use crate::access::Access;
use crate::alarms::{AlarmSources, Alarms, BrokerOutage};
use crate::config::{self, Config, ConfigError, DeviceSource, Flags};
use crate::connections::{self, Bounds};
use crate::events::LiveUpdates;
use crate::fleet::Peers;
use crate::gripper::recorder::{Record, Recorder as _};
use crate::gripper::{Grippers, Now};
use crate::interfaces::mqtt::{MqttContext, MqttRunner};
use crate::interfaces::{self, http, zenoh};
use crate::journal::{self, Journal, Recovered};
use crate::model::{Detail, Event, GatewayEvent};
use crate::operations::calls::audit::Audit;
use crate::operations::readiness::EXPOSED;
use crate::operations::{Gateway, Reloads};
use crate::recipes::Recipes;
use crate::transport::find_same_device;
use crate::trends::Trends;
use crate::wear::Wear;
use crate::webhooks::{WebhookContext, WebhookRunner};
use credentials::watch_credentials;
use descriptors::Shares;
use grippers::RunningGrippers;
use mdns::Announcement;
use modbus::BoundModbus;
use ports::{PortContext, Ports};
use reload::Reloader;
pub use simulation::{ServedDevice, SimulatedDevice, Switch, serve as serve_device};

/// Longest time that the start waits for the journal: as long as a motion waits.
const START_WRITTEN_WITHIN: Duration = Duration::from_millis(500);

/// Runs the gateway until SIGTERM or SIGINT.
///
/// # Errors
/// The reason why the gateway cannot start, and the remedy.
pub fn run(flags: &Flags) -> anyhow::Result<()> {
    let config = Config::load(flags)?;
    check(&config)?;
    let shares = descriptors::share_out(&config)?;
    let runtimes = runtimes::Owned::start(config.modbus.is_some())?;
    runtimes.requests.block_on(run_gateway(flags, config, &runtimes, shares))?;
    runtimes.end();
    Ok(())
}

/// Serves a simulated device on each URL, and the control port for their faults, until SIGTERM or SIGINT.
///
/// # Errors
/// The URL that cannot be served, and the reason.
pub fn run_simulated(urls: &[Url], device: &SimulatedDevice, control: Option<SocketAddr>) -> anyhow::Result<()> {
    let runtime = runtime()?;
    let served = runtime.block_on(async {
        let stop = stop_signal()?;
        tokio::select! {
            served = simulation::serve_simulated(urls, device, control) => served,
            () = stop => Ok(()),
        }
    });
    runtime.shutdown_background();
    served
}

/// Returns a runtime for everything except devices.
///
/// # Errors
/// The operating system's error.
pub fn runtime() -> std::io::Result<Runtime> {
    Builder::new_multi_thread().enable_all().build()
}

/// Checks the simulated devices of the configuration, which only the daemon can.
///
/// # Errors
/// The first [`ConfigError`].
pub fn check(config: &Config) -> Result<(), ConfigError> {
    for gripper in &config.grippers {
        if let DeviceSource::Simulated(url) = &gripper.device {
            SimulatedDevice::from_url(url).map_err(|detail| ConfigError::at(&gripper.place, detail))?;
        }
    }
    Ok(())
}

/// Checks that no two grippers have one device under two names, as far as host names can be resolved now. The gateway
/// itself checks this whenever it connects, since it must start without a name server.
///
/// # Errors
/// The second gripper of a device.
pub async fn check_devices(config: &Config) -> Result<(), ConfigError> {
    let mut grippers = Vec::new();
    let mut addresses = Vec::new();
    for gripper in &config.grippers {
        if let DeviceSource::At(address) = &gripper.device {
            grippers.push(gripper);
            addresses.push(address);
        }
    }
    let Some((first, second, why)) = find_same_device(&addresses).await else { return Ok(()) };
    let first = grippers[first];
    let second = grippers[second];
    let remedy = "use separate addresses, or remove one";
    let detail = format!("{} and {} cannot both be served: {why}: {remedy}", first.name, second.name);
    Err(ConfigError::at(&second.place, detail))
}

/// Checks the files that the configuration names. Reads them, but changes nothing.
///
/// # Errors
/// The first file that the gateway could not start with, and the remedy.
pub fn check_files(config: &Config) -> anyhow::Result<()> {
    reloadable_settings::of_http(config, config.listen.port(), None)?;
    reloadable_settings::of_access(config)?;
    Ok(())
}

async fn run_gateway(flags: &Flags, config: Config, runtimes: &runtimes::Owned, shares: Shares) -> anyhow::Result<()> {
    let stop = stop_signal()?;
    let running = start(flags, config, runtimes, shares).await?;
    systemd::ready();
    tokio::select! {
        () = stop => {}
        () = running.audit.count() => {}
        () = systemd::feed_watchdog(&running.grippers) => {}
    }
    systemd::stopping();
    running.end().await
}

/// The running parts of the gateway.
struct RunningGateway {
    reloading: JoinHandle<Reloader>,
    server: JoinHandle<()>,
    zenoh: Option<JoinHandle<()>>,
    grippers: Grippers,
    webhooks: Arc<WebhookRunner>,
    mqtt: Arc<MqttRunner>,
    audit: Arc<Audit>,
    journal: Journal,
    endings: Endings,
}

/// Ends the reloads, the links to the grippers, and everything else, in this order.
struct Endings {
    stopping: CancellationToken,
    draining: CancellationToken,
    shutdown: CancellationToken,
}

impl RunningGateway {
    /// Releases the grippers, and ends all parts.
    async fn end(self) -> anyhow::Result<()> {
        // A reload under way is finished first, so that no gripper is left behind. If it has failed, the others still
        // have to be drained.
        self.endings.stopping.cancel();
        let mut reloader = self.reloading.await;
        let announcement = reloader.as_mut().ok().and_then(|reloader| reloader.announcement.take());
        let withdrawn = announcement.map(|announcement| tokio::spawn(announcement.withdraw()));
        tracing::info!("shutting down: draining grippers");
        self.endings.draining.cancel();
        self.grippers.drain().await;
        self.endings.shutdown.cancel();
        // Drops the listener, so that new clients are refused at once.
        let (ports, modbus, failure) = match reloader.map(|Reloader { ports, modbus, .. }| (ports, modbus)) {
            Ok((ports, modbus)) => (Some(ports), modbus, None),
            Err(failure) => (None, None, Some(failure)),
        };
        self.server.await?;
        if let Some(zenoh) = self.zenoh {
            zenoh.await?;
        }
        self.webhooks.ended().await;
        self.mqtt.ended().await;
        if let Some(ports) = ports {
            ports.ended().await?;
        }
        if let Some(modbus) = modbus {
            modbus.ended().await?;
        }
        if let Some(withdrawn) = withdrawn {
            withdrawn.await?;
        }
        self.audit.write_down();
        self.journal.close().await?;
        failure.map_or(Ok(()), |failure| Err(failure.into()))
    }
}

fn listen_http(config: &Config, accept: &Handle) -> anyhow::Result<TcpListener> {
    let _inside = accept.enter();
    http::listen(config.listen)
        .map_err(|error| listen::failed(format_args!("cannot listen on {} (--listen)", config.listen), error))
}

async fn start(
    flags: &Flags,
    config: Config,
    runtimes: &runtimes::Owned,
    shares: Shares,
) -> anyhow::Result<RunningGateway> {
    let hang_up = signal(SignalKind::hangup())?;
    // Bound before any gripper is connected, so a taken port does not cost a connect and a disconnect.
    let clients = runtimes.of_clients();
    let listener = listen_http(&config, &clients.accept)?;
    let address = listener.local_addr()?;
    let ports = ports::bind(&config, shares.wsg_port)?;
    let modbus = modbus::bind(&config, shares.wsg_port)?;
    let settings = http::SharedSettings::new(reloadable_settings::of_http(&config, address.port(), None)?);
    let access = Arc::new(Access::new(reloadable_settings::of_access(&config)?));
    reloadable_settings::log_warnings(&config);
    warn_of_exposure(&access);
    let (journal, recovered) = open_journal(&config).await?;
    let draining = CancellationToken::new();
    let shutdown = CancellationToken::new();
    let registry = metrics::registry(&config, &journal)?;
    let port_metrics = connections::metrics::WsgPortMetrics::register(&registry)?;
    let running = RunningGrippers::start(&config, runtimes.devices.handle(), &journal, &recovered, &registry)?;
    let grippers = running.grippers.clone();
    let audit = Arc::new(Audit::new(journal.clone()));
    let peers = Arc::new(Peers::new(config.name.clone(), grippers.clone(), config.web.public_url.clone()));
    let webhooks = start_webhooks(&config, &recovered, &clients.observers, &journal, &registry, &shutdown).await?;
    let expiring = watch_credentials(&access, &settings, &journal, &clients.observers, &registry, &shutdown)?;
    let wear = watch_wear(&config, &journal, &recovered, &clients.observers, &shutdown);
    let alarms = Arc::new(Alarms::new(config.name.clone(), journal.clone(), &recovered.memory));
    let (outage, broker) = watch::channel(None);
    // The links that draining closes raise no alarms.
    let sources = AlarmSources {
        grippers: grippers.clone(),
        peers: peers.clone(),
        wear: wear.clone(),
        webhooks: webhooks.webhooks().clone(),
        expiring,
        broker,
    };
    clients.observers.spawn(alarms.clone().watch(sources, draining.clone()));
    let recipes = Arc::new(Recipes::new(config.name.clone(), journal.clone(), &recovered.memory));
    let (reloads, reload_requests) = Reloads::channel();
    let gateway = Arc::new(Gateway {
        name: config.name.clone(),
        grippers: grippers.clone(),
        journal: journal.clone(),
        audit: audit.clone(),
        peers: peers.clone(),
        alarms: alarms.clone(),
        recipes,
        wear: wear.clone(),
        updates: Arc::new(LiveUpdates::new(grippers.clone(), journal.clone(), peers, alarms)),
        webhooks: webhooks.webhooks().clone(),
        trends: watch_trends(&grippers, &clients.observers, &draining),
        access: access.clone(),
        reloads,
    });
    let context = Arc::new(http::HttpContext {
        gateway,
        closing: shutdown.child_token(),
        runtimes: clients.clone(),
        metrics: connections::metrics::InterfaceMetrics::register(&registry, "http")?,
        ws_metrics: connections::metrics::InterfaceMetrics::register(&registry, "ws")?,
        registry,
        settings: settings.clone(),
        refused_sockets: Arc::default(),
    });
    let mqtt = start_mqtt(&config, &recovered, &context, shutdown.clone(), outage).await?;
    let on_zenoh = config.zenoh.as_ref().map(|zenoh| zenoh_settings(zenoh, &context)).transpose()?;
    tracing::info!(limit = shares.limit, http = shares.http, wsg_port = shares.wsg_port, "connection limits set");
    let limits = http::ServerLimits::within(Bounds::of(shares.http));
    let (listener, listeners) = watch::channel(Arc::new(listener));
    let server = clients.accept.spawn(http::serve(listeners, context.clone(), limits, shutdown.clone()));
    let modbus_address = modbus.as_ref().map(BoundModbus::address).transpose()?;
    announce::announce(&config, address, &ports, modbus_address)?;
    let modbus = match modbus.zip(runtimes.modbus()) {
        Some((modbus, runtime)) => modbus.serve(&config, &context, runtime, (draining.clone(), shutdown.clone()))?,
        None => None,
    };
    let zenoh = on_zenoh.map(|(settings, context)| serve_zenoh(settings, context));
    let port_context = port_context(&context, runtimes.devices.handle(), port_metrics, draining.clone());
    let announcement = Announcement::of(&config, address);
    let reloader = Reloader {
        flags: flags.clone(),
        config,
        shares,
        journal: journal.clone(),
        access,
        settings,
        wear,
        listener,
        announcement,
        accept: clients.accept.clone(),
        grippers: running,
        webhooks: webhooks.clone(),
        mqtt: mqtt.clone(),
        ports: Ports::serve(ports, grippers.clone(), port_context),
        modbus,
    };
    let stopping = CancellationToken::new();
    let reloading = tokio::spawn(reloader.run(reload_requests, hang_up, stopping.clone()));
    let endings = Endings { stopping, draining, shutdown };
    Ok(RunningGateway { reloading, server, zenoh, grippers, webhooks, mqtt, audit, journal, endings })
}

fn port_context(
    context: &http::HttpContext,
    devices: &Handle,
    metrics: connections::metrics::WsgPortMetrics,
    draining: CancellationToken,
) -> PortContext {
    PortContext {
        devices: devices.clone(),
        audit: context.gateway.audit.clone(),
        access: context.gateway.access.clone(),
        metrics,
        draining,
        closing: context.closing.clone(),
    }
}

async fn start_mqtt(
    config: &Config,
    recovered: &Recovered,
    context: &http::HttpContext,
    closing: CancellationToken,
    outage: watch::Sender<Option<BrokerOutage>>,
) -> anyhow::Result<Arc<MqttRunner>> {
    let mqtt = MqttRunner::new(MqttContext {
        gateway: context.gateway.clone(),
        runtimes: context.runtimes.clone(),
        registry: context.registry.clone(),
        closing,
        outage,
    });
    mqtt.apply(config.mqtt.clone(), &recovered.memory).await?;
    Ok(Arc::new(mqtt))
}

async fn start_webhooks(
    config: &Config,
    recovered: &Recovered,
    runtime: &Handle,
    journal: &Journal,
    registry: &Registry,
    closing: &CancellationToken,
) -> anyhow::Result<Arc<WebhookRunner>> {
    let webhooks = WebhookRunner::new(WebhookContext {
        gateway: config.name.clone(),
        journal: journal.clone(),
        registry: registry.clone(),
        closing: closing.clone(),
        runtime: runtime.clone(),
    });
    webhooks.apply(webhooks.prepare(&config.webhooks)?, &recovered.memory).await?;
    Ok(Arc::new(webhooks))
}

fn warn_of_exposure(access: &Access) {
    if access.is_exposed() {
        tracing::warn!("{EXPOSED}");
    }
}

fn watch_wear(
    config: &Config,
    journal: &Journal,
    recovered: &Recovered,
    runtime: &Handle,
    closing: &CancellationToken,
) -> Arc<Wear> {
    let wear = Arc::new(Wear::new(journal.clone(), config.drift, &recovered.memory));
    runtime.spawn(wear.clone().watch(journal.subscribe_grips(), closing.clone()));
    wear
}

fn watch_trends(grippers: &Grippers, runtime: &Handle, closing: &CancellationToken) -> Arc<Trends> {
    let trends = Arc::new(Trends::default());
    runtime.spawn(trends.clone().watch(grippers.clone(), closing.clone()));
    trends
}

/// Opens the journal, and records the start.
async fn open_journal(config: &Config) -> Result<(Journal, Recovered), journal::OpenError> {
    let config::JournalConfig { place, max_age, max_bytes } = config.journal.clone();
    let retention = journal::Retention { max_age, max_bytes };
    let (journal, recovered) = Journal::open(place, retention)?;
    log_unclean_end(&recovered);
    record_start(config, &journal).await;
    Ok((journal, recovered))
}

/// Logs the commands that a previous run left behind without an orderly shutdown.
fn log_unclean_end(recovered: &Recovered) {
    if recovered.unclean {
        let running: Vec<_> = recovered.running.iter().map(ToString::to_string).collect();
        tracing::warn!(
            running = running.join(", "),
            "previous run did not shut down cleanly: its running commands have the outcome UNKNOWN"
        );
    }
}

/// Records the start of this run, and waits until the record is durable. If this run is killed, the record tells the
/// next run that leases may have been granted without its knowledge. A failing disk is reported elsewhere, and does
/// not prevent the start.
async fn record_start(config: &Config, journal: &Journal) {
    let (written, is_written) = oneshot::channel();
    record(journal, started(config), None);
    record(journal, configured(config), Some(written));
    let _ = timeout(START_WRITTEN_WITHIN, is_written).await;
}

fn record(journal: &Journal, event: GatewayEvent, waiter: Option<oneshot::Sender<()>>) {
    journal.record(Record::Event(Event::new(Now::read().wall, None, Detail::Gateway(event)), waiter));
}

fn started(config: &Config) -> GatewayEvent {
    GatewayEvent::Started { version: env!("CARGO_PKG_VERSION"), gateway: config.name.to_string() }
}

fn configured(config: &Config) -> GatewayEvent {
    let grippers = config.grippers.iter().map(|gripper| format!("{}={}", gripper.name, gripper.device));
    GatewayEvent::Configuration { listen: config.listen.to_string(), grippers: grippers.collect() }
}

/// Completes on SIGTERM or SIGINT.
fn stop_signal() -> std::io::Result<impl Future<Output = ()>> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    Ok(async move {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
    })
}

/// Serves Zenoh in a task of its own, so that the rest continues whatever happens to Zenoh.
fn serve_zenoh(settings: zenoh::ZenohSettings, context: interfaces::Context) -> JoinHandle<()> {
    tokio::spawn(zenoh::serve(settings, context, announce::announce_zenoh))
}

fn zenoh_settings(
    zenoh: &config::Zenoh,
    context: &http::HttpContext,
) -> anyhow::Result<(zenoh::ZenohSettings, interfaces::Context)> {
    for endpoint in zenoh.tls_endpoints() {
        tracing::warn!(
            endpoint,
            "TLS on Zenoh can break connections and crash the gateway: use quic/ in place of tls/"
        );
    }
    let network = &context.gateway.peers;
    metrics::register_zenoh(&context.registry, network)?;
    let config = zenoh.settings.clone();
    let listen = zenoh.listen.clone();
    let connect = zenoh.connect.clone();
    let connectivity = zenoh::Connectivity { config, listen, connect };
    // In client mode, opening Zenoh waits for a connection.
    network.set_cause(Some(connectivity.awaited().unwrap_or_else(|| "Zenoh is not open yet".to_owned())));
    let interface_metrics = connections::metrics::InterfaceMetrics::register(&context.registry, "zenoh")?;
    Ok((zenoh::ZenohSettings { connectivity, max_hz: zenoh.max_hz }, context.of_interface(interface_metrics)))
}
