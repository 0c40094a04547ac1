//! The composition root: builds everything, runs it, and shuts it down in order.

mod descriptors;
mod listen;
mod metrics;
mod ports;
mod runtimes;
mod simulation;
mod systemd;

use std::future::Future;
use std::io::Write;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use prometheus::Registry;
use rand::RngExt;
use tokio::runtime::{Builder, Runtime};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::oneshot;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use url::Url;

use crate::access::{Access, Guard, TokenFile, TokenFileError};
use crate::alarms::Alarms;
use crate::config::{self, AccessConfig, Config, ConfigError, DeviceSource, GripperConfig};
use crate::events::LiveUpdates;
use crate::fleet::Peers;
use crate::gripper::model::{Detail, Event, GatewayEvent, Name, PersistedKey};
use crate::gripper::recorder::{Record, Recorder as _, RestoredState};
use crate::gripper::{self, Connector, Grippers, Handle, Now};
use crate::interfaces::dashboard::FramePolicy;
use crate::interfaces::tls::Tls;
use crate::interfaces::{self, Bounds, http, zenoh};
use crate::journal::{self, Journal, Recovered};
use crate::operations::Gateway;
use crate::operations::audit::Audit;
use crate::trends::Trends;
use crate::webhooks::{WebhookContext, Webhooks};
use descriptors::Shares;
pub use simulation::{ServedDevice, SimulatedDevice, Switch, serve as serve_device};

/// Longest time that the start waits for the journal: as long as a motion waits.
const START_WRITTEN_WITHIN: Duration = Duration::from_millis(500);

/// Runs the gateway until SIGTERM or SIGINT.
///
/// # Errors
/// The reason why the gateway cannot start, and the remedy.
pub fn run(config: &Config) -> anyhow::Result<()> {
    check(config)?;
    let shares = descriptors::share_out(config)?;
    let runtimes = runtimes::Owned::start()?;
    runtimes.requests.block_on(run_gateway(config, &runtimes, shares))?;
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

async fn run_gateway(config: &Config, runtimes: &runtimes::Owned, shares: Shares) -> anyhow::Result<()> {
    let stop = stop_signal()?;
    // Bound before any gripper is connected, so a taken port does not cost a connect and a disconnect.
    let clients = runtimes.of_clients();
    let listener = {
        let _inside = clients.accept.enter();
        http::listen(config.listen)
            .map_err(|error| listen::failed(format_args!("cannot listen on {} (--listen)", config.listen), error))?
    };
    let address = listener.local_addr()?;
    let ports = ports::bind(config, shares.wsg_port)?;
    let tls =
        config.tls.clone().map(|config::TlsConfig { certificate, key }| Tls::new(certificate, key)).transpose()?;
    let access = Arc::new(access(&config.access)?);
    if access.is_guarded() && tls.is_none() && !config.listen.ip().is_loopback() {
        tracing::warn!("connections are not encrypted (insecure_http): anyone on the network can read the tokens");
    }
    let (journal, recovered) = open_journal(config)?;
    log_unclean_end(&recovered);
    record_start(config, &journal).await;
    let (draining, shutdown) = (CancellationToken::new(), CancellationToken::new());
    let registry = metrics::registry(config, &journal)?;
    let port_metrics = interfaces::metrics::WsgPortMetrics::register(&registry)?;
    let grippers = spawn_all(config, &runtimes.devices, &journal, &recovered, &registry)?;
    let audit = Arc::new(Audit::new(journal.clone()));
    let peers = Arc::new(Peers::new(config.name.clone(), grippers.clone()));
    let webhook_context = WebhookContext {
        gateway: &config.name,
        journal: &journal,
        persisted: &recovered.memory,
        registry: &registry,
        closing: &shutdown,
        runtime: &clients.observers,
    };
    let webhooks = Arc::new(Webhooks::start(&config.webhooks, &webhook_context)?);
    let alarms = Arc::new(Alarms::new(config.name.clone(), journal.clone(), &recovered.memory));
    // The links that draining closes are no alarms.
    clients.observers.spawn(alarms.clone().watch(grippers.clone(), peers.clone(), draining.clone()));
    let trends = Arc::new(Trends::default());
    clients.observers.spawn(trends.clone().watch(grippers.clone(), draining.clone()));
    let gateway = Arc::new(Gateway {
        name: config.name.clone(),
        grippers: grippers.clone(),
        journal: journal.clone(),
        audit: audit.clone(),
        peers: peers.clone(),
        alarms: alarms.clone(),
        updates: Arc::new(LiveUpdates::new(&grippers, journal.clone(), peers, alarms)),
        webhooks: webhooks.clone(),
        trends: trends.clone(),
        access,
    });
    let context = Arc::new(http::HttpContext {
        gateway,
        closing: shutdown.child_token(),
        runtimes: clients.clone(),
        metrics: interfaces::metrics::InterfaceMetrics::register(&registry, "http")?,
        ws_metrics: interfaces::metrics::InterfaceMetrics::register(&registry, "ws")?,
        registry,
        allowed_hosts: config.hosts.clone(),
        frame_policy: FramePolicy::of(&config.frame_ancestors)?,
        tls: tls.map(Arc::new),
    });
    let on_zenoh = config.zenoh.as_ref().map(|zenoh| zenoh_settings(zenoh, &context)).transpose()?;
    tracing::info!(limit = shares.limit, http = shares.http, wsg_port = shares.wsg_port, "file descriptors shared out");
    let limits =
        http::ServerLimits { idle_time: config.idle_timeout, ..http::ServerLimits::within(Bounds::of(shares.http)) };
    let server = clients.accept.spawn(http::serve(listener, context.clone(), limits, shutdown.clone()));
    announce(config, address, &ports)?;
    // Zenoh has a task of its own, so the rest continues whatever happens to Zenoh.
    let zenoh = on_zenoh.map(|(settings, context)| tokio::spawn(zenoh::serve(settings, context, announce_zenoh)));
    let ports = ports::serve(&runtimes.devices, ports, &grippers, &audit, &port_metrics, &draining, &shutdown);
    systemd::ready();
    tokio::select! {
        () = stop => {}
        () = audit.count() => {}
        () = systemd::feed_watchdog(&grippers) => {}
    }
    systemd::stopping();
    tracing::info!("shutting down: draining grippers");
    draining.cancel();
    grippers.drain().await;
    shutdown.cancel();
    server.await?;
    if let Some(zenoh) = zenoh {
        zenoh.await?;
    }
    webhooks.ended().await;
    ports.join_all().await.into_iter().collect::<Result<(), _>>()?;
    audit.write_down();
    Ok(journal.close().await?)
}

/// Reads the credentials of clients.
fn access(config: &AccessConfig) -> Result<Access, TokenFileError> {
    let AccessConfig::Guarded(guarded) = config else { return Ok(Access::Open) };
    let config::Guarded { tokens, clients, fast_stop, zenoh_role, session_idle } = guarded.clone();
    Guard::new(TokenFile::at(tokens), clients, (fast_stop, zenoh_role), session_idle)
        .map(|guard| Access::Guarded(Box::new(guard)))
}

fn open_journal(config: &Config) -> Result<(Journal, Recovered), journal::OpenError> {
    let config::JournalConfig { place, max_age, max_bytes, .. } = &config.journal;
    let place = match place {
        config::JournalPlace::File(path) => journal::JournalLocation::File(path.clone()),
        config::JournalPlace::Memory => journal::JournalLocation::Memory,
    };
    Journal::open(place, journal::Retention { max_age: *max_age, max_bytes: *max_bytes })
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
    let record = |event, waiter| {
        journal.record(Record::Event(Event::new(Now::read().wall, None, Detail::Gateway(event)), waiter));
    };
    record(started(config), None);
    record(configured(config), Some(written));
    let _ = timeout(START_WRITTEN_WITHIN, is_written).await;
}

fn started(config: &Config) -> GatewayEvent {
    GatewayEvent::Started { version: env!("CARGO_PKG_VERSION"), gateway: config.name.to_string() }
}

fn configured(config: &Config) -> GatewayEvent {
    let grippers = config.grippers.iter().map(|gripper| format!("{}={}", gripper.name, gripper.device));
    GatewayEvent::Configuration { listen: config.listen.to_string(), grippers: grippers.collect() }
}

fn spawn_all(
    config: &Config,
    devices: &Runtime,
    journal: &Journal,
    recovered: &Recovered,
    registry: &Registry,
) -> anyhow::Result<Grippers> {
    let _inside = devices.enter();
    let spawn = |gripper| spawn(config, gripper, journal, restored(recovered, gripper), registry);
    let handles: anyhow::Result<Vec<Handle>> = config.grippers.iter().map(spawn).collect();
    Ok(Grippers::new(handles?))
}

/// Returns the journal's knowledge of a gripper from earlier runs.
fn restored(recovered: &Recovered, gripper: &GripperConfig) -> RestoredState {
    let persisted = |key| {
        let memory = recovered.memory.iter().find(|memory| memory.gripper == gripper.name && memory.key == key);
        memory.and_then(|memory| memory.value.clone())
    };
    let requests = recovered.requests.iter().filter(|request| request.command.gripper == gripper.name);
    RestoredState {
        settings: persisted(PersistedKey::Settings),
        latch: persisted(PersistedKey::Latch),
        lease: persisted(PersistedKey::Lease),
        holding: persisted(PersistedKey::Holding),
        last_command: persisted(PersistedKey::LastCommand),
        requests: requests.cloned().collect(),
        unclean: recovered.unclean,
    }
}

fn spawn(
    config: &Config,
    gripper: &GripperConfig,
    journal: &Journal,
    restored: RestoredState,
    registry: &Registry,
) -> anyhow::Result<Handle> {
    let connector: Arc<dyn Connector> = match &gripper.device {
        DeviceSource::At(address) => Arc::new(address.clone()),
        DeviceSource::Simulated(url) => {
            let device = SimulatedDevice::from_url(url).map_err(|detail| ConfigError::at(&gripper.place, detail))?;
            Arc::new(device.start(url.as_str()))
        }
    };
    let config = gripper::actor::ActorConfig {
        gateway: config.name.clone(),
        name: gripper.name.clone(),
        url: connector.url(),
        properties: connector.properties(),
        fast_stop_on_disconnect: gripper.fast_stop_on_disconnect,
        custom_ids: gripper.custom_ids.clone(),
        updates: gripper.updates,
        motion_pause: gripper.motion_pause,
        drain: config.drain,
        on_journal_failure: config.journal.on_failure,
        lease: gripper.lease.clone(),
        seed: rand::rng().random(),
        metrics: gripper::GripperMetrics::register(registry, &gripper.name)?,
    };
    let handle = gripper::spawn(config, connector, Arc::new(journal.clone()), restored);
    gripper::metrics::Newest::register(registry, &handle)?;
    Ok(handle)
}

/// Completes on SIGTERM or SIGINT. SIGHUP has no function yet, but must not kill the process without a shutdown.
fn stop_signal() -> std::io::Result<impl Future<Output = ()>> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut hang_up = signal(SignalKind::hangup())?;
    Ok(async move {
        loop {
            tokio::select! {
                _ = terminate.recv() => return,
                _ = interrupt.recv() => return,
                _ = hang_up.recv() => tracing::warn!("SIGHUP ignored: reloading is not supported yet"),
            }
        }
    })
}

/// Prints what is served, where, and what to try. Ignores write errors, since nobody may be reading.
fn announce(config: &Config, address: SocketAddr, ports: &[ports::Bound]) -> std::io::Result<()> {
    let urls =
        ports.iter().map(|port| Ok((&port.gripper, port.listener.url()?))).collect::<std::io::Result<Vec<_>>>()?;
    let mut out = std::io::stdout().lock();
    let _ = write_announcement(config, address, &urls, &mut out).and_then(|()| out.flush());
    Ok(())
}

fn zenoh_settings(
    zenoh: &config::Zenoh,
    context: &http::HttpContext,
) -> anyhow::Result<(zenoh::ZenohSettings, interfaces::Context)> {
    let network = &context.gateway.peers;
    metrics::register_zenoh(&context.registry, network)?;
    let (config, listen, connect) = (zenoh.settings.clone(), zenoh.listen.clone(), zenoh.connect.clone());
    let connectivity = zenoh::Connectivity { config, listen, connect };
    // In client mode, opening Zenoh waits for a connection.
    network.set_cause(Some(connectivity.awaited().unwrap_or_else(|| "Zenoh is not open yet".to_owned())));
    let interface_metrics = interfaces::metrics::InterfaceMetrics::register(&context.registry, "zenoh")?;
    Ok((zenoh::ZenohSettings { connectivity, max_hz: zenoh.max_hz }, context.of_interface(interface_metrics)))
}

/// Prints the addresses of Zenoh, which can be known later than the rest.
fn announce_zenoh(locators: &[String]) {
    let mut out = std::io::stdout().lock();
    for locator in locators {
        let _ = writeln!(out, "Zenoh: {locator}").and_then(|()| out.flush());
    }
}

fn write_announcement(
    config: &Config,
    address: SocketAddr,
    ports: &[(&Name, String)],
    out: &mut impl Write,
) -> std::io::Result<()> {
    let scheme = if config.tls.is_some() { "https" } else { "http" };
    let base = format!("{scheme}://{address}");
    writeln!(out, "wsg-gateway {} serves {} at {base}/", env!("CARGO_PKG_VERSION"), config.name)?;
    for gripper in &config.grippers {
        writeln!(out, "  {:<8} {}", gripper.name.as_str(), gripper.device)?;
    }
    for (name, url) in ports {
        writeln!(out, "WSG port of {name}: {url}")?;
    }
    writeln!(out, "documentation: {base}/docs")?;
    writeln!(out, "guides: {base}/docs/guide")?;
    if let Some(gripper) = config.grippers.first() {
        writeln!(out, "try: curl -X POST {base}/api/v1/grippers/{}/home", gripper.name)?;
    }
    Ok(())
}
