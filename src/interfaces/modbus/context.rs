//! The state that all connections share.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::watch;

use crate::connections::foreign::ForeignClients;
use crate::connections::metrics::InterfaceMetrics;
use crate::connections::peers::KnownPeers;
use crate::model::Name;
use crate::model::clock;
use crate::operations::Gateway;

/// Interval in which the gateway's heartbeat grows.
const BEATS_EVERY: Duration = Duration::from_millis(100);

/// Settings that a reload can change.
#[derive(Debug)]
pub struct ModbusSettings {
    pub peers: KnownPeers,
    /// Longest time between two changes of a client's heartbeat.
    pub heartbeat: Duration,
    /// Grippers by their unit identifiers.
    pub units: BTreeMap<u8, Name>,
}

/// The newest settings.
#[derive(Debug, Clone)]
pub(super) struct NewestSettings(watch::Receiver<Arc<ModbusSettings>>);

impl NewestSettings {
    pub(super) fn of(settings: watch::Receiver<Arc<ModbusSettings>>) -> Self {
        Self(settings)
    }

    pub(super) fn now(&self) -> Arc<ModbusSettings> {
        self.0.borrow().clone()
    }

    /// Waits until the configuration is reloaded. Cancel-safe.
    ///
    /// # Errors
    /// The gateway has ended.
    pub(super) async fn changed(&mut self) -> Result<(), watch::error::RecvError> {
        self.0.changed().await
    }
}

/// State that all connections share.
#[derive(Debug)]
pub struct ModbusContext {
    pub(super) gateway: Arc<Gateway>,
    pub(super) metrics: InterfaceMetrics,
    pub(super) foreign: ForeignClients,
    started: Instant,
}

impl ModbusContext {
    #[must_use]
    pub fn new(gateway: Arc<Gateway>, metrics: InterfaceMetrics, foreign: ForeignClients) -> Arc<Self> {
        Arc::new(Self { gateway, metrics, foreign, started: clock::instant() })
    }

    /// Heartbeat of the gateway.
    pub(super) fn heartbeat(&self) -> u16 {
        let beats = clock::instant().duration_since(self.started).as_millis() / BEATS_EVERY.as_millis();
        // The heartbeat wraps around to 0.
        beats as u16
    }

    /// Counts a response with its exception; 0 for none.
    pub(super) fn count(&self, function: u8, exception: u8) {
        let function = match function {
            3 => "read_holding_registers",
            4 => "read_input_registers",
            6 => "write_single_register",
            16 => "write_multiple_registers",
            23 => "read_write_multiple_registers",
            43 => "read_device_identification",
            _ => "other",
        };
        self.metrics.answered(None, function, exception.into());
    }
}
