//! Settings of MQTT. Passwords and keys are never shown.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use tokio_rustls::rustls::ClientConfig;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use url::Url;

use super::topics::Topics;
use crate::access::Role;
use crate::settings::{between, flag, optional_whole, plain, settings, whole};
use crate::transport::host::check_host;
use crate::webhooks::Authorities;

/// Ports of brokers without and with TLS (OASIS MQTT 5.0, 4.2).
const PORT: u16 = 1883;
const TLS_PORT: u16 = 8883;

settings! {
    /// What is published, how often, and which requests are accepted.
    pub struct MqttRules {
        /// Shortest time in ms between two published states of a gripper. An unchanged state is repeated after 10 s.
        pub state_interval: Duration = "state_interval_ms",
            whole(200, between(20..=60_000, ""), Duration::from_millis), Reload;
        /// Time in ms between two publications of a gripper's measured values. By default, they are not published.
        pub telemetry_interval: Option<Duration> = "telemetry_interval_ms",
            optional_whole(1000, between(20..=60_000, "leave it out for no telemetry"), Duration::from_millis), Reload;
        /// Whether the journal's events are published.
        pub events: bool = "events", flag(true), Reload;
        /// Whether grip records are published.
        pub grips: bool = "grips", flag(true), Reload;
        /// Highest number of events and grip records that are published in a second, so that a long outage is made up
        /// for without disturbing others.
        pub max_records_per_s: u32 = "max_records_per_s", whole(500, between(1..=5000, ""), |rate| rate as u32), Reload;
        /// Whether MQTT clients can request operations: see [Commands](mqtt.md#commands).
        pub commands: bool = "commands", flag(false), Reload;
        /// Whether MQTT clients can trigger a FAST STOP: see [FAST STOP](mqtt.md#fast-stop).
        pub fast_stop: bool = "fast_stop", flag(false), Reload;
        /// Role of all MQTT clients. The broker decides who can publish to the topics of requests.
        pub role: Role = "role", plain(Role::Operator, "\"operator\"", "a [role](access.md#roles)"), Reload;
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct MqttSettings {
    pub broker: Broker,
    /// Client identifier of the connection that publishes. The others append their purpose.
    pub client_id: String,
    pub topics: Topics,
    pub login: Option<BrokerLogin>,
    pub rules: MqttRules,
}

/// Address of a broker.
#[derive(Debug, Clone, PartialEq)]
pub struct Broker {
    pub host: String,
    pub port: u16,
    /// `None` if the connection is not encrypted.
    pub tls: Option<BrokerTls>,
}

/// Parsed URL of a broker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BrokerUrl {
    pub host: String,
    pub port: u16,
    pub is_encrypted: bool,
}

fn invalid_broker(detail: &dyn fmt::Display) -> InvalidMqttSetting {
    InvalidMqttSetting(format!("the broker {detail}: write mqtts://broker.example:8883 or mqtt://HOST:1883"))
}

impl FromStr for BrokerUrl {
    type Err = InvalidMqttSetting;

    fn from_str(text: &str) -> Result<Self, InvalidMqttSetting> {
        let url = Url::parse(text).map_err(|error| invalid_broker(&format_args!("is not a valid URL ({error})")))?;
        let is_encrypted = match url.scheme() {
            "mqtt" => false,
            "mqtts" => true,
            _ => return Err(invalid_broker(&"is neither mqtt:// nor mqtts://")),
        };
        if !url.username().is_empty() || url.password().is_some() {
            return Err(invalid_broker(&"contains a user name: use the keys user and password_file"));
        }
        if !matches!(url.path(), "" | "/") || url.query().is_some() || url.fragment().is_some() {
            return Err(invalid_broker(&"has more than a host and a port"));
        }
        let host = url.host_str().unwrap_or_default().trim_matches(['[', ']']).to_owned();
        if host.is_empty() {
            return Err(invalid_broker(&"has no host"));
        }
        check_host(&host).map_err(|error| invalid_broker(&format_args!("has the host {error}")))?;
        let port = url.port().unwrap_or(if is_encrypted { TLS_PORT } else { PORT });
        Ok(Self { host, port, is_encrypted })
    }
}

/// Shows the URL, which contains no secret.
impl fmt::Display for Broker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.tls.is_some() { "mqtts" } else { "mqtt" };
        let host = &self.host;
        let port = self.port;
        if host.contains(':') { write!(f, "{scheme}://[{host}]:{port}") } else { write!(f, "{scheme}://{host}:{port}") }
    }
}

/// User name and password.
#[derive(Clone, PartialEq, Eq)]
pub struct BrokerLogin {
    pub user: String,
    pub(super) password: String,
}

impl BrokerLogin {
    #[must_use]
    pub fn new(user: String, password: String) -> Self {
        Self { user, password }
    }
}

impl fmt::Debug for BrokerLogin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("BrokerLogin").field("user", &self.user).finish_non_exhaustive()
    }
}

/// The gateway's certificate for a broker, and its private key, both in PEM form.
#[derive(Clone, PartialEq, Eq)]
pub struct BrokerCertificate {
    pub certificate: Vec<u8>,
    pub key: Vec<u8>,
}

/// TLS with a broker.
#[derive(Clone)]
pub struct BrokerTls {
    pub(super) config: Arc<ClientConfig>,
    /// Name that the broker's certificate must have.
    pub(super) name: ServerName<'static>,
    authorities: Authorities,
    certificate: Option<BrokerCertificate>,
}

impl BrokerTls {
    /// # Errors
    /// The host cannot be checked, or the certificate and the key are not valid or do not match.
    pub fn new(
        host: &str,
        authorities: Authorities,
        certificate: Option<BrokerCertificate>,
    ) -> Result<Self, InvalidMqttSetting> {
        let name = ServerName::try_from(host.to_owned())
            .map_err(|_| InvalidMqttSetting("the broker has a host that TLS cannot check: use its name".to_owned()))?;
        let builder = ClientConfig::builder_with_provider(Arc::new(default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(|error| InvalidMqttSetting(error.to_string()))?
            .with_root_certificates(authorities.roots());
        let config = match &certificate {
            None => builder.with_no_client_auth(),
            Some(BrokerCertificate { certificate, key }) => {
                let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(certificate).collect();
                let chain = chain.map_err(|error| InvalidMqttSetting(format!("invalid certificate: {error}")))?;
                let key = PrivateKeyDer::from_pem_slice(key);
                let key = key.map_err(|error| InvalidMqttSetting(format!("invalid private key: {error}")))?;
                let config = builder.with_client_auth_cert(chain, key);
                config.map_err(|error| InvalidMqttSetting(format!("certificate and key cannot be used: {error}")))?
            }
        };
        Ok(Self { config: Arc::new(config), name, authorities, certificate })
    }
}

impl PartialEq for BrokerTls {
    fn eq(&self, other: &Self) -> bool {
        // The configuration is made of the other fields.
        let Self { config: _, name, authorities, certificate } = self;
        *name == other.name && *authorities == other.authorities && *certificate == other.certificate
    }
}

impl fmt::Debug for BrokerTls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("BrokerTls").field("name", &self.name).finish_non_exhaustive()
    }
}

/// Error of a setting, with the remedy. It contains no secret.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct InvalidMqttSetting(String);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broker_url_has_a_default_port() {
        let url = |text: &str| text.parse::<BrokerUrl>().map(|url| (url.host, url.port, url.is_encrypted));
        assert_eq!(url("mqtt://broker.example"), Ok(("broker.example".to_owned(), 1883, false)));
        assert_eq!(url("mqtts://broker.example/"), Ok(("broker.example".to_owned(), 8883, true)));
        assert_eq!(url("mqtts://[::1]:1"), Ok(("::1".to_owned(), 1, true)));
    }

    #[test]
    fn wrong_broker_url_is_refused_without_its_secret() {
        for (text, expected) in [
            ("broker.example", "not a valid URL"),
            ("tcp://broker.example", "neither mqtt:// nor"),
            ("mqtt://anna:s3cret@broker.example", "user and password_file"),
            ("mqtt://", "has no host"),
            ("mqtt://broker.example/plant?s3cret", "more than a host and a port"),
            ("mqtt://192.168.001.020", "not a plain IPv4 address"),
        ] {
            let error = text.parse::<BrokerUrl>().unwrap_err().to_string();
            assert!(error.contains(expected) && !error.contains("s3cret"), "{text}: {error}");
        }
    }

    #[test]
    fn password_and_key_are_not_shown() {
        let login = BrokerLogin::new("anna".to_owned(), "s3cret".to_owned());
        assert!(!format!("{login:?}").contains("s3cret"));
        let signed = rcgen::generate_simple_self_signed(["broker.example".to_owned()]).unwrap();
        let key = signed.signing_key.serialize_pem();
        let certificate = BrokerCertificate { certificate: signed.cert.pem().into_bytes(), key: key.into_bytes() };
        let tls = BrokerTls::new("broker.example", Authorities::default(), Some(certificate.clone())).unwrap();
        assert!(!format!("{tls:?}").contains("PRIVATE"));
        let other = rcgen::generate_simple_self_signed(["broker.example".to_owned()]).unwrap();
        let wrong = BrokerCertificate { key: other.signing_key.serialize_pem().into_bytes(), ..certificate };
        assert!(BrokerTls::new("broker.example", Authorities::default(), Some(wrong)).is_err());
    }
}
