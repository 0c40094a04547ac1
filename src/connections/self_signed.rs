//! The gateway's own certificate, for networks without a certification authority: made by `init` and `certificate`, and
//! renewed by the gateway before it ends.

use std::net::IpAddr;

use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp, ToSpan as _};
use rcgen::{
    CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, KeyPair, KeyUsagePurpose, SerialNumber, date_time_ymd,
};
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use uuid::Uuid;
use x509_parser::prelude::{FromDer as _, GeneralName, X509Certificate};

/// Lifetime in days. Apple's systems accept 825 days at most (support.apple.com/103769), and count both ends.
const DAYS: i64 = 824;

/// Time before the end at which the gateway renews its certificate: late, because some clients trust exactly the old one.
const RENEWED_BEFORE: SignedDuration = SignedDuration::from_hours(24);

/// Organisation in the subject, which tells the certificates that the gateway may renew from all others.
const ORGANISATION: &str = "WSG Gateway (self-signed)";

/// A certificate and its key, in PEM.
#[derive(Debug)]
pub struct SelfSigned {
    pub certificate: String,
    pub key: String,
}

/// Reason why a certificate cannot be made or renewed, with the remedy.
#[derive(Debug, thiserror::Error)]
pub enum SelfSignedError {
    #[error("the certificate could not be made: {0}")]
    Generator(#[from] rcgen::Error),
    #[error("the clock shows {0}, which no certificate can have: set the clock")]
    Clock(Timestamp),
    #[error("the certificate in use has no common name")]
    NoName,
}

impl SelfSigned {
    /// Makes a key, and a certificate of the gateway with this name for these hosts.
    ///
    /// # Errors
    /// [`SelfSignedError`]
    pub fn create(gateway: &str, hosts: &[String], now: Timestamp) -> Result<Self, SelfSignedError> {
        let key = KeyPair::generate()?;
        let certificate = signed(gateway, hosts, &key, now)?;
        Ok(Self { certificate, key: key.serialize_pem() })
    }
}

/// Returns a certificate in place of one in PEM that the gateway made itself, if that one ends soon. It has the same key,
/// name and hosts. After a clock that was ahead, a certificate can begin in the future: it is renewed too.
///
/// # Errors
/// [`SelfSignedError`]
pub fn renewed(certificate: &[u8], key: &str, now: Timestamp) -> Result<Option<String>, SelfSignedError> {
    let Ok(der) = CertificateDer::from_pem_slice(certificate) else { return Ok(None) };
    let Ok((_, old)) = X509Certificate::from_der(&der) else { return Ok(None) };
    if !is_own(&old) || !is_due(&old, now) {
        return Ok(None);
    }
    let gateway = old.subject().iter_common_name().find_map(|name| name.as_str().ok());
    let gateway = gateway.ok_or(SelfSignedError::NoName)?;
    signed(gateway, &hosts(&old), &KeyPair::from_pem(key)?, now).map(Some)
}

/// Whether the gateway made this certificate.
pub(crate) fn is_own(certificate: &X509Certificate<'_>) -> bool {
    let mut organisations = certificate.subject().iter_organization().filter_map(|name| name.as_str().ok());
    certificate.subject().as_raw() == certificate.issuer().as_raw() && organisations.any(|name| name == ORGANISATION)
}

fn is_due(certificate: &X509Certificate<'_>, now: Timestamp) -> bool {
    let validity = certificate.validity();
    let renewed_at = now.as_second().saturating_add(RENEWED_BEFORE.as_secs());
    now.as_second() < validity.not_before.timestamp() || renewed_at >= validity.not_after.timestamp()
}

/// Returns the names and addresses that a certificate is for (RFC 5280, 4.2.1.6).
fn hosts(certificate: &X509Certificate<'_>) -> Vec<String> {
    let Ok(Some(names)) = certificate.subject_alternative_name() else { return Vec::new() };
    names.value.general_names.iter().filter_map(host).collect()
}

fn host(name: &GeneralName<'_>) -> Option<String> {
    match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(bytes) => match **bytes {
            [a, b, c, d] => Some(IpAddr::from([a, b, c, d]).to_string()),
            _ => <[u8; 16]>::try_from(*bytes).ok().map(|bytes| IpAddr::from(bytes).to_string()),
        },
        _ => None,
    }
}

fn signed(gateway: &str, hosts: &[String], key: &KeyPair, now: Timestamp) -> Result<String, SelfSignedError> {
    let mut params = CertificateParams::new(hosts)?;
    params.distinguished_name.push(DnType::CommonName, gateway);
    params.distinguished_name.push(DnType::OrganizationName, ORGANISATION);
    // Clients with the certificate as their only authority accept it as the server's own, not as an authority.
    params.is_ca = IsCa::ExplicitNoCa;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    // A client's clock can be a little behind.
    let begin = now.to_zoned(TimeZone::UTC).date().checked_sub(1.day()).map_err(|_| SelfSignedError::Clock(now))?;
    let end = begin.checked_add(DAYS.days()).map_err(|_| SelfSignedError::Clock(now))?;
    params.not_before = date_time_ymd(begin.year().into(), begin.month().unsigned_abs(), begin.day().unsigned_abs());
    params.not_after = date_time_ymd(end.year().into(), end.month().unsigned_abs(), end.day().unsigned_abs());
    // By default, the number depends on the key only. Firefox refuses a second certificate with the number of the first.
    params.serial_number = Some(SerialNumber::from_slice(Uuid::now_v7().as_bytes()));
    Ok(params.self_signed(key)?.pem())
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY: SignedDuration = SignedDuration::from_hours(24);

    fn now() -> Timestamp {
        "2026-11-29T12:00:00Z".parse().unwrap()
    }

    fn created() -> SelfSigned {
        let hosts = ["cell-7.example", "192.168.1.5", "::1"].map(str::to_owned);
        SelfSigned::create("cell-7", &hosts, now()).unwrap()
    }

    fn renewed_at(old: &SelfSigned, now: Timestamp) -> Option<String> {
        renewed(old.certificate.as_bytes(), &old.key, now).unwrap()
    }

    #[test]
    fn certificate_has_a_name_a_use_and_an_end() {
        let made = created();
        let der = CertificateDer::from_pem_slice(made.certificate.as_bytes()).unwrap();
        let (_, certificate) = X509Certificate::from_der(&der).unwrap();
        assert_eq!(certificate.subject().to_string(), "CN=cell-7, O=WSG Gateway (self-signed)");
        let validity = certificate.validity();
        let seconds = validity.not_after.timestamp() - validity.not_before.timestamp();
        assert!(seconds < 825 * DAY.as_secs() && seconds > 800 * DAY.as_secs(), "{seconds}");
        assert!(validity.not_before.timestamp() < now().as_second());
        let usage = certificate.key_usage().unwrap().unwrap().value;
        assert!(usage.digital_signature() && !usage.key_cert_sign());
        assert!(certificate.extended_key_usage().unwrap().unwrap().value.server_auth);
        assert!(!certificate.basic_constraints().unwrap().unwrap().value.ca);
        assert_eq!(hosts(&certificate), ["cell-7.example", "192.168.1.5", "::1"]);
    }

    #[test]
    fn certificate_is_renewed_before_its_end_with_its_key_and_hosts() {
        let made = created();
        assert_eq!(renewed_at(&made, now()), None);
        assert_eq!(renewed_at(&made, now() + DAY * 821), None);
        let later = now() + DAY * 822;
        let next = renewed_at(&made, later).unwrap();
        let [old, new] = [&made.certificate, &next].map(|pem| CertificateDer::from_pem_slice(pem.as_bytes()).unwrap());
        let [(_, old), (_, new)] = [&old, &new].map(|der| X509Certificate::from_der(der).unwrap());
        assert_eq!(old.public_key().raw, new.public_key().raw);
        assert_eq!((old.subject(), hosts(&old)), (new.subject(), hosts(&new)));
        assert_ne!(old.serial, new.serial);
        assert!(new.validity().not_after.timestamp() > (later + DAY * 822).as_second());
        // The clock was ahead, and is right again.
        let ahead = SelfSigned { certificate: next, key: made.key };
        assert!(renewed_at(&ahead, now()).is_some());
    }

    #[test]
    fn other_certificates_are_left_alone() {
        let foreign = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        let pem = foreign.cert.pem();
        let key = foreign.signing_key.serialize_pem();
        let long_after: Timestamp = "4095-12-31T00:00:00Z".parse().unwrap();
        assert_eq!(renewed(pem.as_bytes(), &key, long_after).unwrap(), None);
        assert_eq!(renewed(b"nonsense", &key, long_after).unwrap(), None);
    }
}
