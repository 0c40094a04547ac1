//! Paths of the alarms.

use super::paths;
use super::responses::{AnyProblem, CommandProblem};
use crate::alarms::AlarmReport;
use crate::operations::alarms::{self, AcknowledgeAlarms, AlarmsAcknowledged};

paths! {
    /// List the alarms
    ///
    /// Lists the alarms of this gateway's grippers and of the gateway itself that are active, or that nobody has
    /// acknowledged. All clients share them, and they survive a restart. `GET /events?kind=alarm` has their history.
    #[utoipa::path(
        get, path = "/alarms", operation_id = "alarms", tag = "alarms",
        responses((status = 200, description = "The alarms", body = AlarmReport), AnyProblem)
    )]
    list => alarms::LIST;
}

paths! {
    /// Acknowledge alarms
    ///
    /// Acknowledges the alarms with these ids: one, some, or all that the client has listed. An alarm that has ended is
    /// not listed any more; an active one stays listed until it ends.
    ///
    /// This changes nothing at the device, and clears no FAST STOP: `POST /grippers/{gripper}/acknowledge` does, and
    /// also acknowledges the alarm.
    #[utoipa::path(
        post, path = "/alarms/acknowledge", operation_id = "acknowledge_alarms", tag = "alarms",
        request_body = AcknowledgeAlarms,
        responses((status = 200, description = "The alarms are acknowledged", body = AlarmsAcknowledged), CommandProblem)
    )]
    acknowledge => alarms::ACKNOWLEDGE;
}
