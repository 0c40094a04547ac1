//! The conditions that raise alarms, as a gripper's state shows them.

use std::sync::Arc;
use std::time::{Duration, Instant};

use jiff::Timestamp;

use super::list::{AlarmKey, Conditions};
use crate::access::{CredentialKind, ExpiringCredential};
use crate::model::{AlarmCause, AlarmKind, Fault, Link, Name, State};
use crate::wear::{Wear, WearCondition};
use crate::webhooks::{WebhookProgress, Webhooks};

/// Time for which a webhook or MQTT has to fail before it raises an alarm. A receiver or broker that restarts needs
/// nobody.
const FAILING_FOR: Duration = Duration::from_mins(1);

/// Time that a new connection to the MQTT broker has to last before its outage is over. A broker that is too slow, or
/// that refuses some messages, answers at first, and is lost again within 30 s.
const BROKER_LASTS_FOR: Duration = Duration::from_secs(45);

/// Losses of a new connection to the MQTT broker after which the next one is expected to be lost, too.
const RELAPSES: u32 = 2;

/// Flags of the device that raise alarms.
const FLAGS: [(&str, AlarmKind); 6] = [
    ("TEMP_FAULT", AlarmKind::TemperatureFault),
    ("POWER_FAULT", AlarmKind::PowerFault),
    ("CURR_FAULT", AlarmKind::CurrentFault),
    ("FINGER_FAULT", AlarmKind::FingerFault),
    ("TEMP_WARNING", AlarmKind::TemperatureWarning),
    ("SCRIPT_FAILURE", AlarmKind::ScriptFailure),
];

/// Faults that `fault_code` shows while no more important one hides them.
const FAULTS: [(Fault, AlarmKind); 2] =
    [(Fault::DeviceError, AlarmKind::DeviceError), (Fault::SettingsLost, AlarmKind::SettingsLost)];

/// An outage of a connection to the MQTT broker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BrokerOutage {
    /// Time of the first failure.
    pub since: Instant,
    /// Time at which the connection was opened again; `None` while it is down.
    pub connected_at: Option<Instant>,
    /// How often the connection was lost again soon after it was opened.
    pub relapses: u32,
    /// URL of the broker.
    pub broker: Arc<str>,
    /// The newest failure, with its remedy.
    pub cause: Arc<str>,
}

impl BrokerOutage {
    /// Whether the connection has lasted since it was opened again.
    #[must_use]
    pub fn is_over(&self, now: Instant) -> bool {
        self.connected_at.is_some_and(|at| now.saturating_duration_since(at) >= BROKER_LASTS_FOR)
    }

    /// Whether the connection is down, or is likely to be lost again.
    #[must_use]
    pub fn is_felt(&self) -> bool {
        self.connected_at.is_none() || self.relapses >= RELAPSES
    }
}

/// Returns a cause that is a text.
pub(super) fn text(cause: &str) -> AlarmCause {
    AlarmCause { cause: Some(cause.into()), ..AlarmCause::default() }
}

/// Adds the conditions of a gripper's fingers.
pub(super) fn of_wear(gripper: &Name, wear: &Wear, conditions: &mut Conditions) {
    for WearCondition { alarm, part_id, cause } in wear.conditions(gripper) {
        let key = AlarmKey { part_id: part_id.clone(), ..AlarmKey::of_gripper(alarm, gripper) };
        conditions.insert(key, Some(AlarmCause { part_id, ..text(&cause) }));
    }
}

/// Adds the credentials that end soon or have ended.
pub(super) fn of_credentials(credentials: &[ExpiringCredential], now: Timestamp, conditions: &mut Conditions) {
    for credential in credentials.iter().filter(|credential| credential.needs_attention(now)) {
        let alarm = match credential.kind {
            CredentialKind::Token => AlarmKind::TokenExpiring,
            CredentialKind::Certificate | CredentialKind::RenewedCertificate => AlarmKind::CertificateExpiring,
        };
        add_named(alarm, &credential.name, &credential.notice(now), conditions);
    }
}

/// Adds the webhooks whose receivers have accepted nothing for too long. Their events wait in the journal.
pub(super) fn of_webhooks(webhooks: &Webhooks, now: Instant, conditions: &mut Conditions) {
    for webhook in webhooks.all() {
        let WebhookProgress { failing_since, last_error, .. } = webhook.progress();
        if failing_since.is_some_and(|since| now.saturating_duration_since(since) >= FAILING_FOR) {
            let cause = last_error.unwrap_or_default();
            add_named(AlarmKind::WebhookFailing, &webhook.name().as_str().into(), &cause, conditions);
        }
    }
}

/// Adds a broker that has been away for too long, or is lost again and again. Records wait in the journal.
pub(super) fn of_broker(outage: Option<&BrokerOutage>, now: Instant, conditions: &mut Conditions) {
    let Some(outage) = outage else { return };
    let is_long = now.saturating_duration_since(outage.since) >= FAILING_FOR;
    if is_long && outage.is_felt() && !outage.is_over(now) {
        add_named(AlarmKind::MqttFailing, &outage.broker, &outage.cause, conditions);
    }
}

fn add_named(alarm: AlarmKind, name: &Arc<str>, cause: &str, conditions: &mut Conditions) {
    let key = AlarmKey { name: Some(name.clone()), ..AlarmKey::of_gateway(alarm) };
    conditions.insert(key, Some(AlarmCause { name: Some(name.clone()), ..text(cause) }));
}

/// Adds the conditions of a gripper. One that has only just begun to connect raises no alarm for its link.
pub(super) fn of_gripper(state: &State, now: Instant, is_starting: bool, conditions: &mut Conditions) {
    let gripper = &state.gripper;
    match (&state.latch, state.fast_stop) {
        (Some(latch), _) => {
            let cause = AlarmCause {
                cause: Some(latch.fast_stop_cause.name().into()),
                fast_stop_id: Some(latch.fast_stop_id),
                fast_stop_by: Some(latch.fast_stop_by.clone()),
                fast_stop_reason: Some(latch.fast_stop_reason.as_str().into()),
                ..AlarmCause::default()
            };
            add(AlarmKind::FastStop, gripper, Some(cause), conditions);
        }
        (None, None) => add(AlarmKind::FastStop, gripper, None, conditions),
        (None, Some(_)) => {}
    }
    let link_cause = state.link_cause.as_deref().map_or_else(AlarmCause::default, text);
    match state.link {
        Link::Connected => {}
        Link::Connecting if is_starting => {
            add(AlarmKind::NotReached, gripper, None, conditions);
            add(AlarmKind::LinkDown, gripper, None, conditions);
        }
        Link::Connecting => add(AlarmKind::NotReached, gripper, Some(link_cause), conditions),
        Link::Unresponsive | Link::Reconnecting => add(AlarmKind::LinkDown, gripper, Some(link_cause), conditions),
        Link::Released => add(AlarmKind::LinkReleased, gripper, Some(link_cause), conditions),
    }
    if let (Some(holder), None) = (&state.reserved_for, &state.lease_holder) {
        let cause = AlarmCause { cause: Some(Arc::clone(holder)), ..AlarmCause::default() };
        add(AlarmKind::HolderLost, gripper, Some(cause), conditions);
    }
    let flags = state.values.flag_names(now);
    for (flag, alarm) in FLAGS {
        match &flags {
            Some(flags) if flags.contains(&flag) => add(alarm, gripper, Some(AlarmCause::default()), conditions),
            Some(_) => {}
            None => add(alarm, gripper, None, conditions),
        }
    }
    match state.values.state_name(now) {
        Some("PART_LOST") => add(AlarmKind::PartLost, gripper, Some(AlarmCause::default()), conditions),
        Some(_) => {}
        None => add(AlarmKind::PartLost, gripper, None, conditions),
    }
    // Without the flags, the cause of the link names all unknown values.
    let unknown = state.values.missing(now).filter(|_| state.link == Link::Connected && flags.is_some());
    let unknown: Vec<_> = unknown.map(|(name, missing)| format!("{name} ({missing})")).collect();
    if !unknown.is_empty() {
        add(AlarmKind::ValueUnknown, gripper, Some(text(&unknown.join(", "))), conditions);
    }
    for (fault, alarm) in FAULTS {
        match state.fault_code {
            0 => {}
            code => add(alarm, gripper, (code == fault.code()).then(AlarmCause::default), conditions),
        }
    }
}

fn add(alarm: AlarmKind, gripper: &Name, cause: Option<AlarmCause>, conditions: &mut Conditions) {
    conditions.insert(AlarmKey::of_gripper(alarm, gripper), cause);
}
