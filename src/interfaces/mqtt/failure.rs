//! Reasons why a connection to a broker fails, with the remedies. None of them contains a secret.

use std::io;
use std::time::Duration;

use rumqttc::v5::mqttbytes;
use rumqttc::v5::mqttbytes::v5::{ConnectReturnCode, DisconnectReasonCode, PubAckReason, SubscribeReasonCode};

/// Pause after a broker has refused a topic, since only a person can allow it.
const REFUSED_PAUSE: Duration = Duration::from_secs(30);

/// Reason why a connection to a broker could not be opened, or has ended.
#[derive(Debug, thiserror::Error)]
pub enum MqttFailure {
    #[error("cannot connect: {0}; check that the broker runs and can be reached")]
    Unreachable(io::Error),
    #[error("TLS failed: {0}; check the broker's certificate, or set ca_file to its CA")]
    Tls(io::Error),
    #[error("the broker refused the connection ({0:?}): {remedy}", remedy = remedy(*.0))]
    Refused(ConnectReturnCode),
    #[error("the broker did not answer within {} s: check its load, its log and the network", .0.as_secs())]
    Silent(Duration),
    #[error("the broker took no data for {} s: check its load, its log and the network", .0.as_secs())]
    Stalled(Duration),
    #[error("the broker closed the connection; see its log")]
    Closed,
    #[error("the broker ended the connection ({0:?}): {remedy}", remedy = ended_remedy(*.0))]
    Ended(DisconnectReasonCode),
    #[error("the broker sent an unexpected message: {0}; check that it speaks MQTT 5")]
    Invalid(String),
    #[error(
        "the broker refused a message to {topic} ({reason:?}): allow the gateway's user to publish to all topics below \
         the prefix"
    )]
    PublishRefused { topic: String, reason: PubAckReason },
    #[error(
        "the broker refused the subscription of {topic} ({reason:?}): allow the gateway's user to subscribe to it, or \
         switch commands and fast_stop off"
    )]
    SubscriptionRefused { topic: String, reason: SubscribeReasonCode },
    #[error("the broker sent messages faster than they could be acknowledged")]
    Flooded,
    #[error("internal error; see the gateway's log")]
    Panicked,
}

impl MqttFailure {
    /// Shortest pause before the next attempt.
    pub(super) fn pause(&self) -> Duration {
        match self {
            Self::PublishRefused { .. } | Self::SubscriptionRefused { .. } => REFUSED_PAUSE,
            _ => Duration::ZERO,
        }
    }
}

impl From<mqttbytes::Error> for MqttFailure {
    fn from(error: mqttbytes::Error) -> Self {
        match error {
            // The codec takes a DISCONNECT without a reason for an error (rumqttc 0.25).
            mqttbytes::Error::Io(_) | mqttbytes::Error::PayloadRequired => Self::Closed,
            error => Self::Invalid(error.to_string()),
        }
    }
}

fn remedy(reason: ConnectReturnCode) -> &'static str {
    match reason {
        ConnectReturnCode::BadUserNamePassword | ConnectReturnCode::NotAuthorized => {
            "check user, password_file and certificate, and the broker's list of users"
        }
        ConnectReturnCode::ClientIdentifierNotValid | ConnectReturnCode::BadClientId => "set another client_id",
        ConnectReturnCode::UnsupportedProtocolVersion | ConnectReturnCode::RefusedProtocolVersion => {
            "the broker must speak MQTT 5"
        }
        _ => "see the broker's log",
    }
}

fn ended_remedy(reason: DisconnectReasonCode) -> &'static str {
    match reason {
        DisconnectReasonCode::SessionTakenOver => "another client has the same client_id: give each its own",
        DisconnectReasonCode::ServerShuttingDown => "the broker is shutting down",
        _ => "see the broker's log",
    }
}
