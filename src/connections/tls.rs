//! TLS of the server: the certificate and its key, read again whenever their files change.

use std::fs::{self, File};
use std::io::{self, Write as _};
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

use super::self_signed::{SelfSignedError, is_own, renewed};
use crate::access::{ClientCertificate, CredentialKind, ExpiringCredential};
use crate::model::without_byte_order_mark;

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
    /// Whether clients trust exactly this certificate, so that the gateway does not renew its own one.
    pub pinned: bool,
}

struct Current {
    written: Written,
    usable: Usable,
}

/// Files that can be used.
struct Usable {
    config: Arc<ServerConfig>,
    /// The certificate that ends first; `None` if that cannot be read.
    expiry: Option<ExpiringCredential>,
}

impl std::fmt::Debug for Current {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Current").field("written", &self.written).finish_non_exhaustive()
    }
}

/// Times at which the files were written, and their inodes: a file can be replaced within one tick of the clock.
type Written = [Option<(SystemTime, u64)>; 3];

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

/// Reason why a certificate cannot be renewed.
#[derive(Debug, thiserror::Error)]
pub enum RenewalError {
    #[error(transparent)]
    Files(#[from] TlsError),
    #[error(transparent)]
    SelfSigned(#[from] SelfSignedError),
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
        let current = Current { written: files.written(), usable: files.read()? };
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
            return current.usable.config.clone();
        }
        drop(current);
        let mut current = self.current.write().unwrap_or_else(PoisonError::into_inner);
        if current.written != written {
            current.written = written;
            match self.files.read() {
                Ok(usable) => {
                    tracing::info!(certificate = %self.files.certificate.display(), "new certificate in use");
                    current.usable = usable;
                }
                Err(error) => tracing::error!(%error, "new certificate not used: the last one stays in use"),
            }
        }
        current.usable.config.clone()
    }

    /// Returns the end of the newest certificate, or of one that certifies it if that ends first.
    #[must_use]
    pub fn expiry(&self) -> Option<ExpiringCredential> {
        self.config();
        self.current.read().unwrap_or_else(PoisonError::into_inner).usable.expiry.clone()
    }

    /// Renews the certificate in its file, if it is due and the gateway made it itself. Returns whether it was.
    ///
    /// # Errors
    /// [`RenewalError`]
    pub fn renew(&self, now: Timestamp) -> Result<bool, RenewalError> {
        let TlsFiles { certificate, key, pinned, .. } = &self.files;
        if *pinned {
            return Ok(false);
        }
        let key = String::from_utf8_lossy(&read(key)?).into_owned();
        let Some(renewed) = renewed(&read(certificate)?, &key, now)? else { return Ok(false) };
        replace(certificate, &renewed).map_err(|cause| failed(certificate, cause))?;
        Ok(true)
    }
}

/// Replaces a file in one step, so that nobody reads a part of it. It keeps its permissions.
fn replace(path: &Path, text: &str) -> io::Result<()> {
    let unfinished = path.with_extension("unfinished");
    // A leftover of a killed process, or a link planted by another user.
    match fs::remove_file(&unfinished) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let mut file = File::create_new(&unfinished)?;
    file.set_permissions(fs::metadata(path)?.permissions())?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    fs::rename(unfinished, path)
}

impl TlsFiles {
    fn written(&self) -> Written {
        [Some(&self.certificate), Some(&self.key), self.client_ca.as_ref()].map(|path| written(path?))
    }

    /// Reads the files. TLS 1.2 and 1.3 are spoken, with the cipher suites of rustls, which are all strong. Clients may
    /// have a certificate; one that no authority has signed ends the handshake.
    fn read(&self) -> Result<Usable, TlsError> {
        let Self { certificate, key, client_ca, pinned } = self;
        let chain = certificates(certificate)?;
        let expiry = first_expiry(certificate, &chain, *pinned);
        let mode = fs::metadata(key).map_err(|cause| failed(key, cause))?.mode();
        if mode & FOR_EVERYONE != 0 {
            return Err(TlsError::Exposed { path: key.clone(), mode: mode & 0o777 });
        }
        let private = PrivateKeyDer::from_pem_slice(&read(key)?);
        let private = private.map_err(|cause| TlsError::Pem { path: key.clone(), cause })?;
        let provider = Arc::new(default_provider());
        let verifier = match client_ca {
            None => WebPkiClientVerifier::no_client_auth(),
            Some(path) => {
                let mut authorities = RootCertStore::empty();
                for authority in certificates(path)? {
                    authorities.add(authority).map_err(|cause| no_authority(path, &cause))?;
                }
                let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(authorities), provider.clone());
                verifier.allow_unauthenticated().build().map_err(|cause| no_authority(path, &cause))?
            }
        };
        let mut config = ServerConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(|cause| self.unusable(cause))?
            .with_client_cert_verifier(verifier)
            .with_single_cert(chain, private)
            .map_err(|cause| self.unusable(cause))?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        if client_ca.is_some() {
            // A resumed session would not check the client's certificate again.
            config.session_storage = Arc::new(NoServerSessionStorage {});
            config.send_tls13_tickets = 0;
        }
        Ok(Usable { config: Arc::new(config), expiry })
    }

    fn unusable(&self, cause: rustls::Error) -> TlsError {
        TlsError::Unusable { certificate: self.certificate.clone(), key: self.key.clone(), cause }
    }
}

fn no_authority(path: &Path, cause: &impl ToString) -> TlsError {
    TlsError::NoAuthority { path: path.to_owned(), cause: cause.to_string() }
}

/// Returns the end of the certificate that ends first. Clients check all of a chain.
fn first_expiry(path: &Path, chain: &[CertificateDer<'_>], pinned: bool) -> Option<ExpiringCredential> {
    let ends = chain.iter().filter_map(|certificate| {
        let (_, certificate) = X509Certificate::from_der(certificate).ok()?;
        let validity = certificate.validity();
        Some(ExpiringCredential {
            kind: if is_own(&certificate) && !pinned {
                CredentialKind::RenewedCertificate
            } else {
                CredentialKind::Certificate
            },
            name: path.display().to_string().into(),
            valid_from: Timestamp::from_second(validity.not_before.timestamp()).ok()?,
            expires_at: Timestamp::from_second(validity.not_after.timestamp()).ok()?,
        })
    });
    ends.min_by_key(|credential| credential.expires_at)
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

fn written(path: &Path) -> Option<(SystemTime, u64)> {
    let metadata = fs::metadata(path).ok()?;
    Some((metadata.modified().ok()?, metadata.ino()))
}

fn failed(path: &Path, cause: io::Error) -> TlsError {
    TlsError::File { path: path.to_owned(), cause }
}

fn read(path: &Path) -> Result<Vec<u8>, TlsError> {
    let text = fs::read(path).map_err(|cause| failed(path, cause))?;
    Ok(without_byte_order_mark(&text).to_owned())
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let chain = CertificateDer::pem_slice_iter(&read(path)?).collect::<Result<Vec<_>, _>>();
    chain.map_err(|cause| TlsError::Pem { path: path.to_owned(), cause })
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use jiff::SignedDuration;

    use super::super::self_signed::SelfSigned;
    use super::*;

    #[test]
    fn wrong_file_is_named_with_its_cause() {
        let directory = std::env::temp_dir().join(format!("wsg-tls-{}", std::process::id()));
        fs::create_dir_all(&directory).unwrap();
        let [certificate, key] = ["certificate.pem", "key.pem"].map(|name| directory.join(name));
        let files = || TlsFiles { certificate: certificate.clone(), key: key.clone(), client_ca: None, pinned: false };
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
        // Some editors begin a file with a byte order mark.
        fs::write(&key, format!("\u{FEFF}{}", pair.signing_key.serialize_pem())).unwrap();
        fs::write(&certificate, format!("\u{FEFF}{}", pair.cert.pem())).unwrap();
        Tls::new(files()).unwrap();
        let none = directory.join("authority.pem");
        fs::write(&none, "").unwrap();
        let error = Tls::new(TlsFiles { client_ca: Some(none), ..files() }).unwrap_err().to_string();
        assert!(error.contains("authority.pem cannot be used to check"), "{error}");
        fs::remove_dir_all(directory).unwrap();
    }

    #[test]
    fn own_certificate_is_renewed_in_its_file_unless_it_is_pinned() {
        let directory = std::env::temp_dir().join(format!("wsg-renewal-{}", std::process::id()));
        fs::create_dir_all(&directory).unwrap();
        let [certificate, key] = ["certificate.pem", "key.pem"].map(|name| directory.join(name));
        let now = Timestamp::now();
        let long_ago = now - SignedDuration::from_hours(822 * 24);
        let made = SelfSigned::create("cell-7", &["localhost".to_owned()], long_ago).unwrap();
        fs::write(&certificate, &made.certificate).unwrap();
        fs::write(&key, made.key).unwrap();
        fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).unwrap();
        let files = TlsFiles { certificate: certificate.clone(), key, client_ca: None, pinned: true };
        let pinned = Tls::new(files.clone()).unwrap();
        assert!(!pinned.renew(now).unwrap() && pinned.expiry().unwrap().needs_attention(now));
        let tls = Tls::new(TlsFiles { pinned: false, ..files }).unwrap();
        assert!(tls.renew(now).unwrap() && !tls.expiry().unwrap().needs_attention(now));
        assert!(!tls.renew(now).unwrap(), "it is renewed once");
        assert!(fs::read_to_string(&certificate).unwrap() != made.certificate);
        assert_eq!(fs::read_dir(&directory).unwrap().count(), 2, "no file is left behind");
        fs::remove_dir_all(directory).unwrap();
    }
}
