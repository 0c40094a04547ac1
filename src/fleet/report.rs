//! What is told of a gripper in the fleet: the part of its state that says whether it can be worked with.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::gripper::model::{FastStopId, Name, Text};

/// That part, as the gateway that owns the gripper has published it. What it calls things is bounded here.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(super) struct PeerReport {
    link: Text<32>,
    age_ms: Option<u64>,
    state: Option<Text<32>>,
    moving: Option<bool>,
    width_mm: Option<f32>,
    force_n: Option<f32>,
    fast_stop: Option<bool>,
    fast_stop_id: Option<FastStopId>,
    fast_stop_confirmed: Option<bool>,
    lease_holder: Option<Text<64>>,
}

impl PeerReport {
    /// Of a state's JSON; none where it is no state.
    pub(super) fn of(state: &[u8]) -> Option<Self> {
        serde_json::from_slice(state).ok()
    }

    /// Whether its gateway knows of a FAST STOP, which it repeats until the gripper has confirmed it.
    pub(super) fn is_latched(&self) -> bool {
        self.fast_stop == Some(true)
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.fast_stop == Some(true) && self.fast_stop_confirmed == Some(true)
    }

    /// As clients are told, so long after it came.
    pub(super) fn of_gripper(&self, gateway: &Name, gripper: &Name, since: Duration, gone: bool) -> FleetGripper {
        let text = |text: &Option<Text<64>>| text.as_ref().map(|text| text.as_str().to_owned());
        FleetGripper {
            gateway: gateway.to_string(),
            gripper: gripper.to_string(),
            gone,
            link: self.link.as_str().to_owned(),
            age_ms: self.age_ms.map(|age_ms| age_ms.saturating_add(since.as_millis() as u64)),
            state: self.state.as_ref().map(|state| state.as_str().to_owned()),
            moving: self.moving,
            width_mm: self.width_mm,
            force_n: self.force_n,
            fast_stop: self.fast_stop,
            fast_stop_id: self.fast_stop_id,
            fast_stop_confirmed: self.fast_stop_confirmed,
            lease_holder: text(&self.lease_holder),
        }
    }
}

/// A gripper of any gateway on the network.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(example = json!({
    "gateway": "cell-7", "gripper": "left", "gone": false, "link": "connected", "age_ms": 12, "state": "HOLDING",
    "moving": false, "width_mm": 20.0, "force_n": 40.0, "fast_stop": false, "lease_holder": "robot-1"
}))]
pub struct FleetGripper {
    /// The gateway that owns it.
    #[schema(max_length = 32)]
    gateway: String,
    /// Its name there.
    #[schema(max_length = 32)]
    gripper: String,
    /// Whether its gateway is gone: what is told here is what it told last.
    gone: bool,
    /// How the link to the device is: `connecting`, `connected`, `unresponsive` or `reconnecting`.
    #[schema(max_length = 32)]
    link: String,
    /// The age of the newest update from the device; null before the first.
    #[schema(required, minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    age_ms: Option<u64>,
    /// The gripper state, by the manual's noun; null before the first update.
    #[schema(required, max_length = 32)]
    state: Option<String>,
    /// Whether the fingers are moving; null before the first update.
    #[schema(required)]
    moving: Option<bool>,
    /// The opening width in mm; null until referenced.
    #[schema(required, minimum = -1000, maximum = 1000)]
    width_mm: Option<f32>,
    /// The gripping force in N.
    #[schema(required, minimum = -10000, maximum = 10000)]
    force_n: Option<f32>,
    /// Whether a FAST STOP holds; null until the first connect.
    #[schema(required)]
    fast_stop: Option<bool>,
    /// What an acknowledge has to name; only while one holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<uuid::Uuid>, nullable = false)]
    fast_stop_id: Option<FastStopId>,
    /// Whether the device's flags showed it; only while one holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    fast_stop_confirmed: Option<bool>,
    /// Who holds the lease; null while nobody does.
    #[schema(required, max_length = 64)]
    lease_holder: Option<String>,
}

impl FleetGripper {
    /// By which it is found: its gateway, and its name there.
    #[must_use]
    pub fn name(&self) -> (String, String) {
        (self.gateway.clone(), self.gripper.clone())
    }

    /// What is told without what changes all the time.
    #[must_use]
    pub fn lasting(&self) -> Self {
        Self { age_ms: None, ..self.clone() }
    }
}
