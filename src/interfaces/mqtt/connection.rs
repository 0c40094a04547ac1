//! A connection to a broker, up to its CONNACK.
//!
//! Each connection begins without a session of the broker. The gateway's own journal knows what is still to be sent, and
//! a request that has waited in a broker's session would move fingers later than its client believes.

use std::time::Duration;

use bytes::Bytes;
use futures_util::{SinkExt as _, StreamExt as _};
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{
    Codec, Connect, ConnectProperties, ConnectReturnCode, Disconnect, DisconnectReasonCode, LastWill, Login, Packet,
};
use strum::IntoStaticStr;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::timeout;
use tokio_rustls::TlsConnector;
use tokio_util::codec::Framed;

use super::failure::MqttFailure;
use super::mqtt_settings::MqttSettings;
use crate::connections::sockets;
use crate::transport::host::connect_to_host;

/// Time limit for connecting to any of the broker's addresses.
const CONNECTED_WITHIN: Duration = Duration::from_secs(10);

/// Time limit of the TLS handshake and of the answer to CONNECT.
const ANSWERED_WITHIN: Duration = Duration::from_secs(10);

/// Time limit for a broker to take a message.
const TAKEN_WITHIN: Duration = Duration::from_secs(10);

/// Interval of pings. A broker announces the gateway's loss after one and a half of it (MQTT 5.0, 3.1.2.10).
pub(super) const PINGED_EVERY: Duration = Duration::from_secs(5);

/// Time without a message from the broker after which it is lost: it answers each ping.
pub(super) const LOST_AFTER: Duration = Duration::from_secs(10);

/// Largest message from a broker, in bytes. A larger request is dropped by the broker (MQTT 5.0, 3.1.2.11.4).
const MAX_PACKET_BYTES: u32 = 1024 * 1024;

/// Messages that a broker may send before it gets their acknowledgements.
const RECEIVE_MAXIMUM: u16 = 1000;

/// Messages that a broker accepts before it acknowledges them, unless it says otherwise (MQTT 5.0, 3.2.2.3.3).
const DEFAULT_RECEIVE_MAXIMUM: u16 = u16::MAX;

/// Last will of the availability, and its counterpart.
pub(super) const OFFLINE: &str = "offline";
pub(super) const ONLINE: &str = "online";
pub(super) const AVAILABILITY: &str = "availability";

/// Purpose of a connection. Each has its own, so that a flood of one kind fills neither the queue nor the connection of
/// another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum ConnectionPurpose {
    Publications,
    Commands,
    FastStops,
    /// A check of the settings.
    Check,
}

impl ConnectionPurpose {
    pub(super) fn name(self) -> &'static str {
        self.into()
    }

    fn client_id(self, client_id: &str) -> String {
        match self {
            Self::Publications => client_id.to_owned(),
            Self::Commands => format!("{client_id}-commands"),
            Self::FastStops => format!("{client_id}-fast-stop"),
            Self::Check => format!("{client_id}-check"),
        }
    }
}

/// A byte pipe to a broker, encrypted or not.
pub(super) trait BrokerPipe: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> BrokerPipe for T {}

pub(super) type BrokerStream = Framed<Box<dyn BrokerPipe>, Codec>;

/// An open connection.
pub(super) struct BrokerConnection {
    pub(super) stream: BrokerStream,
    /// Number of messages that the broker accepts before it acknowledges them.
    pub(super) receive_maximum: u16,
}

impl BrokerConnection {
    /// Opens a connection.
    pub(super) async fn open(settings: &MqttSettings, purpose: ConnectionPurpose) -> Result<Self, MqttFailure> {
        let broker = &settings.broker;
        let stream = connect_to_host(&broker.host, broker.port, CONNECTED_WITHIN).await;
        let stream = stream.map_err(MqttFailure::Unreachable)?;
        sockets::prepare(&stream).map_err(MqttFailure::Unreachable)?;
        let opening = async {
            let pipe: Box<dyn BrokerPipe> = match &broker.tls {
                Some(tls) => {
                    let connector = TlsConnector::from(tls.config.clone());
                    let stream = connector.connect(tls.name.clone(), stream).await;
                    Box::new(stream.map_err(MqttFailure::Tls)?)
                }
                None => Box::new(stream),
            };
            let codec = Codec { max_incoming_size: Some(MAX_PACKET_BYTES), max_outgoing_size: None };
            greet(Framed::new(pipe, codec), settings, purpose).await
        };
        timeout(ANSWERED_WITHIN, opening).await.map_err(|_| MqttFailure::Silent(ANSWERED_WITHIN))?
    }

    /// Announces the end of the connection, so that the broker does not publish the last will.
    pub(super) async fn close(mut self) -> Result<(), MqttFailure> {
        let farewell = Packet::Disconnect(Disconnect::new(DisconnectReasonCode::NormalDisconnection));
        send(&mut self.stream, farewell).await
    }
}

/// Sends CONNECT, and waits for CONNACK.
async fn greet(
    mut stream: BrokerStream,
    settings: &MqttSettings,
    purpose: ConnectionPurpose,
) -> Result<BrokerConnection, MqttFailure> {
    let properties = ConnectProperties {
        receive_maximum: Some(RECEIVE_MAXIMUM),
        max_packet_size: Some(MAX_PACKET_BYTES),
        ..ConnectProperties::new()
    };
    let connect = Connect {
        keep_alive: PINGED_EVERY.as_secs() as u16,
        client_id: purpose.client_id(&settings.client_id),
        clean_start: true,
        properties: Some(properties),
    };
    let will = (purpose == ConnectionPurpose::Publications).then(|| {
        let topic = settings.topics.own(AVAILABILITY);
        LastWill::new(topic, Bytes::from_static(OFFLINE.as_bytes()), QoS::AtLeastOnce, true, None)
    });
    let login = settings.login.as_ref().map(|login| Login::new(&login.user, &login.password));
    stream.send(Packet::Connect(connect, will, login)).await?;
    match stream.next().await {
        Some(Ok(Packet::ConnAck(answer))) if answer.code == ConnectReturnCode::Success => {
            let receive_maximum = answer.properties.as_ref().and_then(|properties| properties.receive_max);
            let receive_maximum = receive_maximum.unwrap_or(DEFAULT_RECEIVE_MAXIMUM);
            stream.codec_mut().max_outgoing_size = answer.properties.and_then(|properties| properties.max_packet_size);
            Ok(BrokerConnection { stream, receive_maximum })
        }
        Some(Ok(Packet::ConnAck(answer))) => Err(MqttFailure::Refused(answer.code)),
        packet => Err(received(packet).err().unwrap_or_else(|| MqttFailure::Invalid("no CONNACK".to_owned()))),
    }
}

/// Returns a received packet, or the reason why there is none.
pub(super) fn received(packet: Option<Result<Packet, rumqttc::v5::mqttbytes::Error>>) -> Result<Packet, MqttFailure> {
    match packet {
        Some(Ok(Packet::Disconnect(disconnect))) => Err(MqttFailure::Ended(disconnect.reason_code)),
        Some(Ok(packet)) => Ok(packet),
        Some(Err(error)) => Err(error.into()),
        None => Err(MqttFailure::Closed),
    }
}

/// Sends a packet to a broker that takes it in time.
pub(super) async fn send<S>(sink: &mut S, packet: Packet) -> Result<(), MqttFailure>
where
    S: futures_util::Sink<Packet, Error = rumqttc::v5::mqttbytes::Error> + Unpin,
{
    match timeout(TAKEN_WITHIN, sink.send(packet)).await {
        Ok(sent) => Ok(sent?),
        Err(_) => Err(MqttFailure::Stalled(TAKEN_WITHIN)),
    }
}

/// Checks that the broker accepts a connection with these settings.
///
/// # Errors
/// The reason why not, with the remedy.
pub async fn check(settings: &MqttSettings) -> Result<(), MqttFailure> {
    BrokerConnection::open(settings, ConnectionPurpose::Check).await?.close().await
}
