//! The composition root: builds everything, runs it, and ends it in order.

mod descriptors;
mod listen;
mod metrics;
mod ports;
mod runtimes;
mod simulation;

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

use crate::config::{self, Config, ConfigError, Device, Gripper};
use crate::events::Updates;
use crate::fleet::Peers;
use crate::gripper::model::{Detail, Event, GatewayEvent, Name, PersistedKey};
use crate::gripper::recorder::{Record, Recorder as _, RestoredState};
use crate::gripper::{self, Connector, Grippers, Handle, Now};
use crate::interfaces::{self, Bounds, http, zenoh};
use crate::journal::{self, Journal, Recovered};
use crate::operations::Gateway;
use crate::operations::audit::Audit;
use descriptors::Shares;
pub use simulation::{Served, SimulatedDevice, Switch, serve as serve_device};

/// How long a start waits for the journal: as long as a motion does.
const START_WRITTEN_WITHIN: Duration = Duration::from_millis(500);

/// Runs the gateway until SIGTERM or SIGINT.
///
/// # Errors
/// Where it can't start: each says what is wrong, and what to do.
pub fn run(config: &Config) -> anyhow::Result<()> {
    check(config)?;
    let shares = descriptors::share_out(config)?;
    let runtimes = runtimes::Owned::start()?;
    runtimes.requests.block_on(run_gateway(config, &runtimes, shares))?;
    runtimes.end();
    Ok(())
}

/// Serves a simulated device on each of these URLs, and their faults on the control port, until SIGTERM or SIGINT.
///
/// # Errors
/// Where a URL can't be served: which, and why.
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

/// A runtime for everything but devices.
///
/// # Errors
/// As the operating system says.
pub fn runtime() -> std::io::Result<Runtime> {
    Builder::new_multi_thread().enable_all().build()
}

/// Checks what only the daemon can: the simulated devices of the configuration.
///
/// # Errors
/// The first [`ConfigError`].
pub fn check(config: &Config) -> Result<(), ConfigError> {
    for gripper in &config.grippers {
        if let Device::Simulated(url) = &gripper.device {
            SimulatedDevice::from_url(url).map_err(|detail| ConfigError::at(&gripper.place, detail))?;
        }
    }
    Ok(())
}

async fn run_gateway(config: &Config, runtimes: &runtimes::Owned, shares: Shares) -> anyhow::Result<()> {
    let stop = stop_signal()?;
    // Before any gripper is connected: a port that is taken must not cost a connect and a disconnect.
    let clients = runtimes.of_clients();
    let listener = {
        let _inside = clients.accept.enter();
        http::listen(config.listen)
            .map_err(|error| listen::failed(format_args!("cannot listen on {} (--listen)", config.listen), error))?
    };
    let address = listener.local_addr()?;
    let ports = ports::bind(config, shares.wsg_port)?;
    let (journal, recovered) = open_journal(config)?;
    tell_of_last_run(&recovered);
    write_down_start(config, &journal).await;
    let (draining, shutdown) = (CancellationToken::new(), CancellationToken::new());
    let registry = metrics::registry(&config.name, &journal)?;
    let grippers = spawn_all(config, &runtimes.devices, &journal, &recovered, &registry)?;
    let audit = Arc::new(Audit::new(journal.clone()));
    let peers = Arc::new(Peers::new(config.name.clone(), grippers.clone()));
    let gateway = Arc::new(Gateway {
        name: config.name.clone(),
        grippers: grippers.clone(),
        journal: journal.clone(),
        audit: audit.clone(),
        peers: peers.clone(),
        updates: Arc::new(Updates::new(&grippers, journal.clone(), peers)),
    });
    let context = Arc::new(http::Context {
        gateway,
        closing: shutdown.child_token(),
        runtimes: clients.clone(),
        metrics: interfaces::metrics::Metrics::register(&registry, "http")?,
        ws_metrics: interfaces::metrics::Metrics::register(&registry, "ws")?,
        registry,
        allowed_hosts: config.hosts.clone(),
    });
    let on_zenoh = config.zenoh.as_ref().map(|zenoh| zenoh_settings(zenoh, &context)).transpose()?;
    tracing::info!(limit = shares.limit, http = shares.http, wsg_port = shares.wsg_port, "file descriptors shared out");
    let limits = http::Limits::within(Bounds::of(shares.http));
    let server = clients.accept.spawn(http::serve(listener, context.clone(), limits, shutdown.clone()));
    announce(config, address, &ports)?;
    // Of its own: whatever becomes of it, the rest goes on.
    let zenoh = on_zenoh.map(|(settings, context)| tokio::spawn(zenoh::serve(settings, context, announce_zenoh)));
    let ports = ports::serve(&runtimes.devices, ports, &grippers, &audit, &draining, &shutdown);
    tokio::select! {
        () = stop => {}
        () = audit.count() => {}
    }
    tracing::info!("ending: the grippers first");
    draining.cancel();
    grippers.drain().await;
    shutdown.cancel();
    server.await?;
    if let Some(zenoh) = zenoh {
        zenoh.await?;
    }
    ports.join_all().await.into_iter().collect::<Result<(), _>>()?;
    audit.write_down();
    Ok(journal.close().await?)
}

fn open_journal(config: &Config) -> Result<(Journal, Recovered), journal::OpenError> {
    let config::Journal { place, max_age, max_bytes, .. } = &config.journal;
    let place = match place {
        config::JournalPlace::File(path) => journal::Place::File(path.clone()),
        config::JournalPlace::Memory => journal::Place::Memory,
    };
    Journal::open(place, journal::Retention { max_age: *max_age, max_bytes: *max_bytes })
}

/// Says what a run that has not ended in order left behind.
fn tell_of_last_run(recovered: &Recovered) {
    if recovered.unclean {
        let running: Vec<_> = recovered.running.iter().map(ToString::to_string).collect();
        tracing::warn!(running = running.join(", "), "the last run has not ended in order: what ran then is UNKNOWN");
    }
}

/// Says that this run has begun, and waits until that is durable: by that the next run knows that leases were given which
/// it may not know of, if this one is killed. A disk that doesn't take it is said to be so elsewhere, and ends no start.
async fn write_down_start(config: &Config, journal: &Journal) {
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

/// What the journal knows of a gripper from earlier runs.
fn restored(recovered: &Recovered, gripper: &Gripper) -> RestoredState {
    let remembered = |key| {
        let memory = recovered.memory.iter().find(|memory| memory.gripper == gripper.name && memory.key == key);
        memory.and_then(|memory| memory.value.clone())
    };
    let requests = recovered.requests.iter().filter(|request| request.command.gripper == gripper.name);
    RestoredState {
        settings: remembered(PersistedKey::Settings),
        latch: remembered(PersistedKey::Latch),
        lease: remembered(PersistedKey::Lease),
        holding: remembered(PersistedKey::Holding),
        requests: requests.cloned().collect(),
        unclean: recovered.unclean,
    }
}

fn spawn(
    config: &Config,
    gripper: &Gripper,
    journal: &Journal,
    restored: RestoredState,
    registry: &Registry,
) -> anyhow::Result<Handle> {
    let connector: Arc<dyn Connector> = match &gripper.device {
        Device::At(address) => Arc::new(address.clone()),
        Device::Simulated(url) => {
            let device = SimulatedDevice::from_url(url).map_err(|detail| ConfigError::at(&gripper.place, detail))?;
            Arc::new(device.start(url.as_str()))
        }
    };
    let on_journal_failure = match config.journal.on_failure {
        config::OnJournalFailure::Refuse => gripper::actor::OnJournalFailure::Refuse,
        config::OnJournalFailure::Continue => gripper::actor::OnJournalFailure::Continue,
    };
    let config = gripper::actor::Config {
        name: gripper.name.clone(),
        url: connector.url(),
        properties: connector.properties(),
        custom_ids: gripper.custom_ids.clone(),
        drain: config.drain,
        on_journal_failure,
        lease: gripper.lease.clone(),
        seed: rand::rng().random(),
        metrics: gripper::Metrics::register(registry, &gripper.name)?,
    };
    let handle = gripper::spawn(config, connector, Arc::new(journal.clone()), restored);
    gripper::metrics::Newest::register(registry, &handle)?;
    Ok(handle)
}

/// Comes when the process is asked to end. SIGHUP does nothing yet, and must not be the process's unannounced end.
fn stop_signal() -> std::io::Result<impl Future<Output = ()>> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut hang_up = signal(SignalKind::hangup())?;
    Ok(async move {
        loop {
            tokio::select! {
                _ = terminate.recv() => return,
                _ = interrupt.recv() => return,
                _ = hang_up.recv() => tracing::warn!("SIGHUP: reloading is not supported yet, nothing was changed"),
            }
        }
    })
}

/// Says on standard output what is served, where, and what to try. Nobody may be reading it.
fn announce(config: &Config, address: SocketAddr, ports: &[ports::Bound]) -> std::io::Result<()> {
    let urls =
        ports.iter().map(|port| Ok((&port.gripper, port.listener.url()?))).collect::<std::io::Result<Vec<_>>>()?;
    let mut out = std::io::stdout().lock();
    let _ = write_announcement(config, address, &urls, &mut out).and_then(|()| out.flush());
    Ok(())
}

fn zenoh_settings(
    zenoh: &config::Zenoh,
    context: &http::Context,
) -> anyhow::Result<(zenoh::Settings, interfaces::Context)> {
    let network = &context.gateway.peers;
    metrics::register_zenoh(&context.registry, network)?;
    let (config, listen, connect) = (zenoh.settings.clone(), zenoh.listen.clone(), zenoh.connect.clone());
    let connectivity = zenoh::Connectivity { config, listen, connect };
    // A client's Zenoh waits until it is connected.
    network.set_cause(Some(connectivity.awaited().unwrap_or_else(|| "Zenoh is not open yet".to_owned())));
    let figures = interfaces::metrics::Metrics::register(&context.registry, "zenoh")?;
    Ok((zenoh::Settings { connectivity, max_hz: zenoh.max_hz }, context.of_interface(figures)))
}

/// Says where Zenoh is, which may be later than all else.
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
    let base = format!("http://{address}");
    writeln!(out, "wsg-gateway {} serves {} at {base}/", env!("CARGO_PKG_VERSION"), config.name)?;
    for gripper in &config.grippers {
        writeln!(out, "  {:<8} {}", gripper.name.as_str(), gripper.device)?;
    }
    for (name, url) in ports {
        writeln!(out, "WSG port of {name}: {url}")?;
    }
    writeln!(out, "documentation: {base}/docs")?;
    if let Some(gripper) = config.grippers.first() {
        writeln!(out, "try: curl -X POST {base}/api/v1/grippers/{}/home", gripper.name)?;
    }
    Ok(())
}
