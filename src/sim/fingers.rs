//! The finger interface of fw4 (`fw4-en 3.6`): two ports, each with or without an intelligent finger.

use std::time::{Duration, Instant};

use wsg::{FingerFlags, FingerInfo, FingerType, Status};

use super::config::FingerConfig;

/// Duration of powering up (`fw4-en 3.6.3`).
const POWER_UP: Duration = Duration::from_millis(500);

/// Size in bytes of a WSG-FMF's data, a float.
const FMF_DATA_BYTES: u16 = 4;

#[derive(Debug)]
pub(super) struct FingerPort {
    config: FingerConfig,
    powered: bool,
    pub powered_up_at: Option<Instant>,
    pub over_current: bool,
    pub communication_fault: bool,
}

impl FingerPort {
    /// Creates a port, powered at start (`fw4-en 3.6.3`).
    pub fn new(config: FingerConfig) -> Self {
        Self { config, powered: true, powered_up_at: None, over_current: false, communication_fault: false }
    }

    /// Restores power at a restart. Faults remain.
    pub fn restart(&mut self) {
        self.powered = !self.over_current;
        self.powered_up_at = None;
    }

    pub fn is_faulty(&self) -> bool {
        self.over_current || self.communication_fault
    }

    pub fn set_over_current(&mut self, on: bool) {
        self.over_current = on;
        if on {
            self.powered = false;
            self.powered_up_at = None;
        }
    }

    pub fn info(&self) -> FingerInfo {
        let (finger_type, data_bytes) = match &self.config {
            FingerConfig::None | FingerConfig::Generic => (FingerType::Generic, 0),
            FingerConfig::Fmf => (FingerType::Fmf, FMF_DATA_BYTES),
            FingerConfig::Dsa { frame } => (FingerType::Dsa, u16::try_from(frame.len()).unwrap_or(u16::MAX)),
        };
        FingerInfo { finger_type, data_bytes }
    }

    pub fn flags(&self) -> FingerFlags {
        let mut flags = FingerFlags::empty();
        flags.set(FingerFlags::POWER_ON, self.powered);
        flags.set(FingerFlags::CONFIG_AVAIL, self.is_intelligent());
        flags.set(FingerFlags::COMM_OPEN, self.is_intelligent() && self.powered && !self.communication_fault);
        flags.set(FingerFlags::POWER_FAULT, self.over_current);
        flags.set(FingerFlags::COMM_FAULT, self.communication_fault);
        flags
    }

    /// Switches power, and returns the immediate status of the request. Only generic fingers can be switched; the
    /// manual names no status for other fingers.
    pub fn set_power(&mut self, on: bool, now: Instant) -> Status {
        if self.is_intelligent() {
            return Status::E_NOT_AVAILABLE;
        }
        if !on {
            self.powered = false;
            return Status::E_SUCCESS;
        }
        if self.over_current {
            return Status::E_CMD_FAILED;
        }
        if self.powered_up_at.is_some() {
            return Status::E_ALREADY_RUNNING;
        }
        self.powered = true;
        self.powered_up_at = Some(now + POWER_UP);
        Status::E_CMD_PENDING
    }

    /// Data of the finger at a gripping force of `force_n`.
    ///
    /// # Errors
    /// `E_NOT_AVAILABLE` if the finger has no data, `E_IO_ERROR` if it is unreachable.
    pub fn data(&self, force_n: f64) -> Result<Vec<u8>, Status> {
        let data = match &self.config {
            FingerConfig::None | FingerConfig::Generic => return Err(Status::E_NOT_AVAILABLE),
            FingerConfig::Fmf => ((force_n / 2.0) as f32).to_le_bytes().to_vec(),
            FingerConfig::Dsa { frame } => frame.clone(),
        };
        if self.communication_fault || !self.powered { Err(Status::E_IO_ERROR) } else { Ok(data) }
    }

    fn is_intelligent(&self) -> bool {
        matches!(self.config, FingerConfig::Fmf | FingerConfig::Dsa { .. })
    }
}
