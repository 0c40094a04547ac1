//! The part of a gripper's state that the fleet lists: enough to see whether the gripper can be used.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use url::Url;

use super::keys::MAX_SUBJECT_BYTES;
use crate::model::{FastStopId, Name, Text};

/// A gripper's state as published by the gateway that owns it. The lengths of its texts are bounded here.
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
    lease_holder: Option<Text<MAX_SUBJECT_BYTES>>,
}

impl PeerReport {
    /// Parses a state's JSON; returns `None` if it is not a state.
    pub(super) fn of(state: &[u8]) -> Option<Self> {
        serde_json::from_slice(state).ok()
    }

    /// Whether the gateway knows of a FAST STOP, which it repeats until the gripper has confirmed it.
    pub(super) fn is_latched(&self) -> bool {
        self.fast_stop == Some(true)
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.fast_stop == Some(true) && self.fast_stop_confirmed == Some(true)
    }

    /// Returns the list entry for clients. `since` is the time since the report arrived.
    pub(super) fn of_gripper(&self, gateway: &Name, gripper: &Name, since: Duration, gone: bool) -> FleetGripper {
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
            lease_holder: self.lease_holder.as_ref().map(|holder| holder.as_str().to_owned()),
            dashboard: None,
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
    /// Gateway that owns the gripper.
    #[schema(max_length = 32)]
    gateway: String,
    /// Name of the gripper at that gateway.
    #[schema(max_length = 32)]
    gripper: String,
    /// Whether that gateway is gone. If so, the other fields have its last report.
    gone: bool,
    /// State of the link to the device: `connecting`, `connected`, `unresponsive`, `reconnecting` or
    /// `released`.
    #[schema(max_length = 32)]
    link: String,
    /// Age of the newest update from the device, in ms; null before the first.
    #[schema(required, minimum = 0)]
    age_ms: Option<u64>,
    /// Gripper state, as the manual names it; null before the first update.
    #[schema(required, max_length = 32)]
    state: Option<String>,
    /// Whether the fingers are moving; null before the first update.
    #[schema(required)]
    moving: Option<bool>,
    /// Opening width in mm; null until referenced.
    #[schema(required, minimum = -1000, maximum = 1000)]
    width_mm: Option<f32>,
    /// Gripping force in N.
    #[schema(required, minimum = -10000, maximum = 10000)]
    force_n: Option<f32>,
    /// Whether a FAST STOP is latched; null until the first connect.
    #[schema(required)]
    fast_stop: Option<bool>,
    /// Id to name in the acknowledgement; only while a FAST STOP is latched.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    fast_stop_id: Option<FastStopId>,
    /// Whether the device's flags showed the FAST STOP; only while one is latched.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    fast_stop_confirmed: Option<bool>,
    /// Holder of the lease; null while the gripper is not leased.
    #[schema(required, max_length = 86)]
    lease_holder: Option<String>,
    /// URL of that gateway's dashboard, if its configuration has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(format = "uri", max_length = 512, nullable = false)]
    dashboard: Option<String>,
}

impl FleetGripper {
    /// Adds the URL of the gateway's dashboard.
    pub(super) fn shown_at(self, dashboard: Option<&Url>) -> Self {
        Self { dashboard: dashboard.map(ToString::to_string), ..self }
    }

    /// The names of the gateway and the gripper.
    #[must_use]
    pub fn name(&self) -> (String, String) {
        (self.gateway.clone(), self.gripper.clone())
    }

    /// Id of the latched FAST STOP, if one is latched.
    #[must_use]
    pub fn fast_stop_id(&self) -> Option<FastStopId> {
        self.fast_stop_id
    }

    /// Returns a copy without the age, which changes all the time.
    #[must_use]
    pub fn lasting(&self) -> Self {
        Self { age_ms: None, ..self.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn report_has_the_longest_name_of_a_lease_holder() {
        let report = |bytes: usize| {
            let holder = "h".repeat(bytes);
            PeerReport::of(format!(r#"{{"link": "connected", "lease_holder": "{holder}"}}"#).as_bytes())
        };
        assert!(report(MAX_SUBJECT_BYTES).is_some() && report(MAX_SUBJECT_BYTES + 1).is_none());
    }
}
