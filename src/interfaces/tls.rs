//! TLS of the server: the certificate and its key, read again whenever their files change.

use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::SystemTime;

use jiff::Timestamp;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::pem::{self, PemObject as _};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::{NoServerSessionStorage, WebPkiClientVerifier};
use tokio_rustls::rustls::{self, RootCertStore, ServerConfig};
use x509_parser::prelude::{FromDer as _, GeneralName, X509Certificate};

use crate::access::ClientCertificate;

/// Permissions that the key's file must not grant. Its group may read it, as on many systems.
const FOR_EVERYONE: u32 = 0o007;

/// The files of a server's certificate, and the configuration of TLS made of them.
#[derive(Debug)]
pub struct Tls {
    files: TlsFiles,
    current: RwLock<Current>,
}

/// Files in PEM.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlsFiles {
    /// The server's certificate, followed by those that certify it.
    pub certificate: PathBuf,
    /// The certificate's private key.
    pub key: PathBuf,
    /// Certificates of the authorities that sign clients' certificates.
    pub client_ca: Option<PathBuf>,
}

struct Current {
    written: Written,
    config: Arc<ServerConfig>,
}

impl std::fmt::Debug for Current {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Current").field("written", &self.written).finish_non_exhaustive()
    }
}

/// Times at which the files were written.
type Written = [Option<SystemTime>; 3];

/// Reason why a certificate cannot be used, with the remedy.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    #[error("{path}: {cause}: check the path, and that the gateway's user can read the file")]
    File { path: PathBuf, cause: io::Error },
    #[error("{path} can be read by everyone (mode {mode:03o}): run chmod 600 {path}")]
    Exposed { path: PathBuf, mode: u32 },
    #[error("{path} has no certificate or key in PEM: {cause}")]
    Pem { path: PathBuf, cause: pem::Error },
    #[error("{certificate} and {key} cannot be used together: {cause}")]
    Unusable { certificate: PathBuf, key: PathBuf, cause: rustls::Error },
    #[error("{path} cannot be used to check clients' certificates: {cause}")]
    NoAuthority { path: PathBuf, cause: String },
}

impl TlsError {
    /// The file that caused the error; the key if certificate and key cannot be used together.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::File { path, .. }
            | Self::Exposed { path, .. }
            | Self::Pem { path, .. }
            | Self::NoAuthority { path, .. } => path,
            Self::Unusable { key, .. } => key,
        }
    }
}

impl Tls {
    /// # Errors
    /// [`TlsError`]
    pub fn new(files: TlsFiles) -> Result<Self, TlsError> {
        let current = Current { written: files.written(), config: files.config()? };
        Ok(Self { files, current: RwLock::new(current) })
    }

    #[must_use]
    pub fn files(&self) -> &TlsFiles {
        &self.files
    }

    /// Returns a configuration with the newest certificate. If the new files cannot be used, the last ones stay in use.
    pub fn config(&self) -> Arc<ServerConfig> {
        let written = self.files.written();
        let current = self.current.read().unwrap_or_else(PoisonError::into_inner);
        if current.written == written {
            return current.config.clone();
        }
        drop(current);
        let mut current = self.current.write().unwrap_or_else(PoisonError::into_inner);
        if current.written != written {
            current.written = written;
            match self.files.config() {
                Ok(config) => {
                    tracing::info!(certificate = %self.files.certificate.display(), "new certificate in use");
                    current.config = config;
                }
                Err(error) => tracing::error!(%error, "new certificate not used: the last one stays in use"),
            }
        }
        current.config.clone()
    }
}

impl TlsFiles {
    fn written(&self) -> Written {
        let modified = |path: &Path| fs::metadata(path).and_then(|metadata| metadata.modified()).ok();
        [Some(&self.certificate), Some(&self.key), self.client_ca.as_ref()]
            .map(|path| path.and_then(|path| modified(path)))
    }

    /// Reads the files. TLS 1.2 and 1.3 are spoken, with the cipher suites of rustls, which are all strong. Clients may
    /// have a certificate; one that no authority has signed ends the handshake.
    fn config(&self) -> Result<Arc<ServerConfig>, TlsError> {
        let Self { certificate, key, client_ca } = self;
        let chain = certificates(certificate)?;
        let mode = fs::metadata(key).map_err(|cause| failed(key, cause))?.mode();
        if mode & FOR_EVERYONE != 0 {
            return Err(TlsError::Exposed { path: key.clone(), mode: mode & 0o777 });
        }
        let private = PrivateKeyDer::from_pem_slice(&read(key)?);
        let private = private.map_err(|cause| TlsError::Pem { path: key.clone(), cause })?;
        let unusable = |cause| TlsError::Unusable { certificate: certificate.clone(), key: key.clone(), cause };
        let provider = Arc::new(default_provider());
        let verifier = match client_ca {
            None => WebPkiClientVerifier::no_client_auth(),
            Some(path) => {
                let unusable = |cause: String| TlsError::NoAuthority { path: path.clone(), cause };
                let mut authorities = RootCertStore::empty();
                for authority in certificates(path)? {
                    authorities.add(authority).map_err(|cause| unusable(cause.to_string()))?;
                }
                let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(authorities), provider.clone());
                verifier.allow_unauthenticated().build().map_err(|cause| unusable(cause.to_string()))?
            }
        };
        let mut config = ServerConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(unusable)?
            .with_client_cert_verifier(verifier)
            .with_single_cert(chain, private)
            .map_err(unusable)?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        if client_ca.is_some() {
            // A resumed session would not check the client's certificate again.
            config.session_storage = Arc::new(NoServerSessionStorage {});
            config.send_tls13_tickets = 0;
        }
        Ok(Arc::new(config))
    }
}

/// Returns the holder of a client's certificate, if it has one common name.
#[must_use]
pub fn holder(certificate: &CertificateDer<'_>) -> Option<ClientCertificate> {
    let (_, certificate) = X509Certificate::from_der(certificate).ok()?;
    let mut names = certificate.subject().iter_common_name();
    // With two names, it would be unclear which one the authority has checked.
    let (name, None) = (names.next()?, names.next()) else { return None };
    let common_name = name.as_str().ok()?.into();
    let expires_at = Timestamp::from_second(certificate.validity().not_after.timestamp()).ok()?;
    Some(ClientCertificate { common_name, expires_at })
}

/// Returns the first DNS name that a server's certificate is for (RFC 5280, 4.2.1.6); `None` if it has none.
#[must_use]
pub fn server_name(certificate: &CertificateDer<'_>) -> Option<String> {
    let (_, certificate) = X509Certificate::from_der(certificate).ok()?;
    let names = certificate.subject_alternative_name().ok()??;
    names.value.general_names.iter().find_map(|name| match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        _ => None,
    })
}

fn failed(path: &Path, cause: io::Error) -> TlsError {
    TlsError::File { path: path.to_owned(), cause }
}

fn read(path: &Path) -> Result<Vec<u8>, TlsError> {
    fs::read(path).map_err(|cause| failed(path, cause))
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let chain = CertificateDer::pem_slice_iter(&read(path)?).collect::<Result<Vec<_>, _>>();
    chain.map_err(|cause| TlsError::Pem { path: path.to_owned(), cause })
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn wrong_file_is_named_with_its_cause() {
        let directory = std::env::temp_dir().join(format!("wsg-tls-{}", std::process::id()));
        fs::create_dir_all(&directory).unwrap();
        let [certificate, key] = ["certificate.pem", "key.pem"].map(|name| directory.join(name));
        let files = || TlsFiles { certificate: certificate.clone(), key: key.clone(), client_ca: None };
        let said = || Tls::new(files()).unwrap_err().to_string();
        assert!(said().contains("certificate.pem: No such file"), "{}", said());
        let pair = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        fs::write(&certificate, pair.cert.pem()).unwrap();
        fs::write(&key, "nonsense").unwrap();
        fs::set_permissions(&key, fs::Permissions::from_mode(0o644)).unwrap();
        assert!(said().contains("key.pem can be read by everyone (mode 644): run chmod 600"), "{}", said());
        fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).unwrap();
        assert!(said().contains("key.pem has no certificate or key"), "{}", said());
        let other = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        fs::write(&key, other.signing_key.serialize_pem()).unwrap();
        assert!(said().contains("cannot be used together"), "{}", said());
        fs::write(&key, pair.signing_key.serialize_pem()).unwrap();
        Tls::new(files()).unwrap();
        let none = directory.join("authority.pem");
        fs::write(&none, "").unwrap();
        let error = Tls::new(TlsFiles { client_ca: Some(none), ..files() }).unwrap_err().to_string();
        assert!(error.contains("authority.pem cannot be used to check"), "{error}");
        fs::remove_dir_all(directory).unwrap();
    }
}
