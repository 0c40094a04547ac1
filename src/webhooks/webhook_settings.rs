//! Settings of a webhook. The secret is never shown, nor is the URL's path, which can contain a secret.

use std::fmt;
use std::str::FromStr;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Deserialize;
use tokio_rustls::rustls::RootCertStore;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName, TrustAnchor, pem::PemObject as _};
use url::{Position, Url};

use crate::journal::EventKind;
use crate::model::Name;
use crate::transport::host::parse_web_url;

/// Prefix of a secret in text form (Standard Webhooks, "Signature scheme").
const SECRET_PREFIX: &str = "whsec_";

/// Limits of a secret's length in bytes (Standard Webhooks, "Signature scheme").
const MIN_SECRET_BYTES: usize = 24;
const MAX_SECRET_BYTES: usize = 64;

#[derive(Debug, Clone, PartialEq)]
pub struct WebhookSettings {
    pub name: Name,
    pub receiver: Receiver,
    /// Kinds of events that are delivered; `None` means all.
    pub kinds: Option<Vec<EventKind>>,
    pub secret: SigningSecret,
    /// Certificate authorities that can vouch for an HTTPS receiver.
    pub authorities: Authorities,
}

/// Validated URL of a receiver.
#[derive(Clone, PartialEq, Eq)]
pub struct Receiver {
    url: Url,
    /// Name that the certificate must have; `None` without TLS.
    pub(super) tls_name: Option<ServerName<'static>>,
}

impl FromStr for Receiver {
    type Err = InvalidSetting;

    fn from_str(text: &str) -> Result<Self, InvalidSetting> {
        let invalid =
            |detail: &str| InvalidSetting(format!("the webhook's url {detail}: write https://mes.example/hooks/wsg"));
        let url = parse_web_url(text).map_err(|error| invalid(&error.to_string()))?;
        if !url.username().is_empty() || url.password().is_some() {
            return Err(invalid("contains a user name: the signature identifies the gateway"));
        }
        let host = url.host_str().filter(|host| !host.is_empty()).ok_or_else(|| invalid("has no host"))?;
        let name = host.trim_matches(['[', ']']).to_owned();
        let tls_name = match url.scheme() {
            "http" => None,
            "https" => Some(ServerName::try_from(name).map_err(|_| invalid("has a host that TLS cannot check"))?),
            _ => return Err(invalid("is neither http:// nor https://")),
        };
        Ok(Self { url, tls_name })
    }
}

impl Receiver {
    /// Host and port to connect to.
    pub(super) fn address(&self) -> (&str, u16) {
        let host = self.url.host_str().unwrap_or_default().trim_matches(['[', ']']);
        (host, self.url.port_or_known_default().unwrap_or_default())
    }

    /// Value of the `Host` header.
    pub(super) fn authority(&self) -> &str {
        &self.url[Position::BeforeHost..Position::AfterPort]
    }

    /// Path and query of the request.
    pub(super) fn target(&self) -> &str {
        &self.url[Position::BeforePath..Position::AfterQuery]
    }
}

/// Shows scheme, host and port only.
impl fmt::Display for Receiver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.url.origin().ascii_serialization())
    }
}

impl fmt::Debug for Receiver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Secret that signs deliveries.
#[derive(Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct SigningSecret(Vec<u8>);

impl SigningSecret {
    pub(super) fn bytes(&self) -> &[u8] {
        &self.0
    }
}

impl FromStr for SigningSecret {
    type Err = InvalidSetting;

    fn from_str(text: &str) -> Result<Self, InvalidSetting> {
        let base64 = text.trim().strip_prefix(SECRET_PREFIX).and_then(|base64| STANDARD.decode(base64).ok());
        base64.filter(|secret| (MIN_SECRET_BYTES..=MAX_SECRET_BYTES).contains(&secret.len())).map(Self).ok_or_else(
            || {
                InvalidSetting(format!(
                    "the webhook's secret is not {SECRET_PREFIX} and {MIN_SECRET_BYTES} to {MAX_SECRET_BYTES} bytes in \
                     base64: create one with echo {SECRET_PREFIX}$(openssl rand -base64 32)"
                ))
            },
        )
    }
}

impl TryFrom<String> for SigningSecret {
    type Error = InvalidSetting;

    fn try_from(text: String) -> Result<Self, InvalidSetting> {
        text.parse()
    }
}

impl fmt::Debug for SigningSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SigningSecret(…)")
    }
}

/// Trusted certificate authorities. The default is Mozilla's list, which is compiled into the program.
#[derive(Clone, PartialEq, Eq)]
pub struct Authorities(Vec<TrustAnchor<'static>>);

impl Default for Authorities {
    fn default() -> Self {
        Self(webpki_roots::TLS_SERVER_ROOTS.to_vec())
    }
}

impl Authorities {
    /// Reads the certificates in a PEM file's content.
    ///
    /// # Errors
    /// A certificate is invalid, or the file has none.
    pub fn from_pem(pem: &[u8]) -> Result<Self, InvalidSetting> {
        let mut roots = RootCertStore::empty();
        for certificate in CertificateDer::pem_slice_iter(pem) {
            let certificate = certificate.map_err(|error| InvalidSetting(format!("invalid PEM: {error}")))?;
            roots.add(certificate).map_err(|error| InvalidSetting(format!("invalid certificate: {error}")))?;
        }
        if roots.is_empty() {
            return Err(InvalidSetting("no certificate in PEM form: name the file of the receiver's CA".to_owned()));
        }
        Ok(Self(roots.roots))
    }

    /// Returns the authorities as TLS takes them.
    #[must_use]
    pub fn roots(&self) -> RootCertStore {
        RootCertStore { roots: self.0.clone() }
    }
}

impl fmt::Debug for Authorities {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Authorities({})", self.0.len())
    }
}

/// Error of a setting, with the remedy. It does not repeat the value, which can be secret.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct InvalidSetting(String);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn url_is_split_for_the_request() {
        let receiver: Receiver = "https://mes.example:8443/hooks/s3cret?line=7#top".parse().unwrap();
        assert_eq!(receiver.address(), ("mes.example", 8443));
        assert_eq!(receiver.authority(), "mes.example:8443");
        assert_eq!(receiver.target(), "/hooks/s3cret?line=7");
        let receiver: Receiver = "http://[::1]".parse().unwrap();
        assert_eq!((receiver.address(), receiver.authority(), receiver.target()), (("::1", 80), "[::1]", "/"));
        assert!("https://[::1]:1".parse::<Receiver>().is_ok());
    }

    #[test]
    fn invalid_url_is_refused() {
        for (url, expected) in [
            ("mes.example", "not a valid URL"),
            ("ftp://mes.example", "neither http"),
            ("https://user:s3cret@mes.example", "user name"),
            ("https://", "not a valid URL"),
            ("http://192.168.001.020/s3cret", "has the host \"192.168.001.020\", which is not a plain IPv4 address"),
            ("https://127.1:8443/s3cret", "without leading zeros"),
        ] {
            let error = url.parse::<Receiver>().unwrap_err().to_string();
            assert!(error.contains(expected) && !error.contains("s3cret"), "{error}");
        }
    }

    #[test]
    fn secrets_are_never_shown() {
        let receiver: Receiver = "https://mes.example/hooks/s3cret?key=s3cret".parse().unwrap();
        assert_eq!(format!("{receiver} {receiver:?}"), "https://mes.example https://mes.example");
        let text = format!("{SECRET_PREFIX}{}", STANDARD.encode([7; 24]));
        let secret: SigningSecret = text.parse().unwrap();
        assert_eq!(format!("{secret:?}"), "SigningSecret(…)");
        for wrong in ["s3cret", &text[..20], "whsec_s3cret"] {
            let error = wrong.parse::<SigningSecret>().unwrap_err().to_string();
            assert!(error.contains("openssl rand") && !error.contains(wrong), "{error}");
        }
    }

    #[test]
    fn authorities_come_from_pem() {
        let certified = rcgen::generate_simple_self_signed(["mes.example".to_owned()]).unwrap();
        assert_eq!(Authorities::from_pem(certified.cert.pem().as_bytes()).unwrap().roots().len(), 1);
        for wrong in ["", "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"] {
            assert!(Authorities::from_pem(wrong.as_bytes()).is_err());
        }
        assert!(Authorities::default().roots().len() > 50);
    }
}
