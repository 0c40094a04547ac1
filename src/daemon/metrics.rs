//! The registry of all metrics, and the metrics of the gateway itself.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use prometheus::core::{Collector, Desc};
use prometheus::process_collector::ProcessCollector;
use prometheus::proto::MetricFamily;
use prometheus::{IntCounter, IntGauge, Opts, Registry, Result};
use tokio::sync::watch;

use crate::config::{Config, JournalLocation};
use crate::fleet::Peers;
use crate::gripper::Recorder as _;
use crate::gripper::recorder::JournalHealth;
use crate::journal::Journal;

/// Returns a registry with the metrics of the process, the gateway and its journal.
pub(super) fn registry(config: &Config, journal: &Journal) -> Result<Registry> {
    let registry = Registry::new();
    registry.register(Box::new(ProcessCollector::for_self()))?;
    let info = Opts::new("wsg_build_info", "The gateway's name and version.")
        .const_label("gateway", config.name.as_str())
        .const_label("version", env!("CARGO_PKG_VERSION"));
    let info = IntGauge::with_opts(info)?;
    info.set(1);
    registry.register(Box::new(info))?;
    registry.register(Box::new(HealthCollector {
        health: journal.health(),
        counted: Mutex::default(),
        up: IntGauge::new("wsg_journal_up", "Whether the journal accepts records.")?,
        damaged: IntGauge::new("wsg_journal_damaged", "Whether earlier records in the journal were found damaged.")?,
        restored: IntGauge::new(
            "wsg_journal_restored",
            "Whether the journal does not continue that of the last run, and nobody has confirmed it.",
        )?,
        clock_doubtful: IntGauge::new(
            "wsg_clock_doubtful",
            "Whether the clock has jumped so far ahead that no record is removed for its age.",
        )?,
        lost: IntCounter::new(
            "wsg_journal_records_lost_total",
            "Records lost because the journal could not take them.",
        )?,
    }))?;
    if let JournalLocation::File(path) = &config.journal.place {
        let bytes = IntGauge::new("wsg_journal_bytes", "Size of the journal's file and of its write-ahead log.")?;
        registry.register(Box::new(JournalSize { path: path.clone(), bytes }))?;
    }
    Ok(registry)
}

/// Size of the journal, read at each scrape.
struct JournalSize {
    path: PathBuf,
    bytes: IntGauge,
}

impl Collector for JournalSize {
    fn desc(&self) -> Vec<&Desc> {
        self.bytes.desc()
    }

    fn collect(&self) -> Vec<MetricFamily> {
        let mut log = OsString::from(&self.path);
        log.push("-wal");
        let bytes = file_bytes(&self.path) + file_bytes(Path::new(&log));
        self.bytes.set(i64::try_from(bytes).unwrap_or(i64::MAX));
        self.bytes.collect()
    }
}

/// Returns 0 for a missing file: the write-ahead log need not exist.
fn file_bytes(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |file| file.len())
}

/// Health of the journal, read at each scrape.
struct HealthCollector {
    health: watch::Receiver<JournalHealth>,
    /// Lost records that the counter includes.
    counted: Mutex<u64>,
    up: IntGauge,
    damaged: IntGauge,
    restored: IntGauge,
    clock_doubtful: IntGauge,
    lost: IntCounter,
}

impl Collector for HealthCollector {
    fn desc(&self) -> Vec<&Desc> {
        let gauges = [&self.up, &self.damaged, &self.restored, &self.clock_doubtful];
        gauges.into_iter().flat_map(IntGauge::desc).chain(self.lost.desc()).collect()
    }

    fn collect(&self) -> Vec<MetricFamily> {
        let JournalHealth { failure, lost, damage, restored, clock } = self.health.borrow().clone();
        let mut counted = self.counted.lock().unwrap_or_else(PoisonError::into_inner);
        self.lost.inc_by(lost.saturating_sub(*counted));
        *counted = lost.max(*counted);
        self.up.set(failure.is_none().into());
        self.damaged.set(damage.is_some().into());
        self.restored.set(restored.is_some().into());
        self.clock_doubtful.set(clock.is_some().into());
        let gauges = [&self.up, &self.damaged, &self.restored, &self.clock_doubtful];
        gauges.into_iter().flat_map(IntGauge::collect).chain(self.lost.collect()).collect()
    }
}

/// Registers the metric of whether Zenoh is connected as configured.
pub(super) fn register_zenoh(registry: &Registry, network: &Peers) -> Result<()> {
    let up = IntGauge::new("wsg_zenoh_up", "Whether Zenoh listens and is connected as configured.")?;
    registry.register(Box::new(ZenohHealth { cause: network.cause(), up }))
}

/// Health of Zenoh, read at each scrape.
struct ZenohHealth {
    cause: watch::Receiver<Option<String>>,
    up: IntGauge,
}

impl Collector for ZenohHealth {
    fn desc(&self) -> Vec<&Desc> {
        self.up.desc()
    }

    fn collect(&self) -> Vec<MetricFamily> {
        self.up.set(self.cause.borrow().is_none().into());
        self.up.collect()
    }
}
