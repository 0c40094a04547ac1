//! Orders to a gripper, as both register maps make them.

use serde_json::Value;

use crate::operations::{Method, Operation};

/// An order to a gripper.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum ModbusOrder {
    Motion {
        method: Method,
        fields: Value,
    },
    /// A motion to an end of the stroke.
    Jog {
        opens: bool,
        speed_mm_s: f64,
    },
    Stop,
    /// A Stop, or the acknowledgement of the FAST STOP that the client has seen.
    StopOrAcknowledge,
    /// Acknowledges the FAST STOP with this number; 0 stands for a fault of the device.
    Acknowledge {
        number: u16,
    },
    TakeLease(Value),
    ReleaseLease,
}

/// A register value that the map does not define.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct OutOfRange;

impl ModbusOrder {
    /// Whether the order is refused while its client still requests a FAST STOP.
    pub(super) fn is_blocked_by_fast_stop(&self) -> bool {
        match self {
            Self::Motion { .. } | Self::Jog { .. } | Self::StopOrAcknowledge | Self::Acknowledge { .. } => true,
            Self::Stop | Self::TakeLease(_) | Self::ReleaseLease => false,
        }
    }

    pub(super) fn motion(operation: &'static Operation, fields: Value) -> Self {
        Self::Motion { method: operation.into(), fields }
    }
}
