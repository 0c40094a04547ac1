//! TLS of the server: the certificate and its key, read again whenever their files change.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::SystemTime;

use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::pem::{self, PemObject as _};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{self, ServerConfig};

/// The files of a certificate, and the acceptor made of them.
#[derive(Debug)]
pub struct Tls {
    certificate: PathBuf,
    key: PathBuf,
    current: RwLock<Current>,
}

struct Current {
    written: Written,
    acceptor: TlsAcceptor,
}

impl std::fmt::Debug for Current {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Current").field("written", &self.written).finish_non_exhaustive()
    }
}

/// Times at which the certificate and the key were written.
type Written = [Option<SystemTime>; 2];

/// Reason why a certificate cannot be used, with the remedy.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    #[error("{path}: {cause}")]
    File { path: PathBuf, cause: io::Error },
    #[error("{path} has no certificate or key in PEM: {cause}")]
    Pem { path: PathBuf, cause: pem::Error },
    #[error("{certificate} and {key} cannot be used together: {cause}")]
    Unusable { certificate: PathBuf, key: PathBuf, cause: rustls::Error },
}

impl Tls {
    /// # Errors
    /// [`TlsError`]
    pub fn new(certificate: PathBuf, key: PathBuf) -> Result<Self, TlsError> {
        let written = written(&certificate, &key);
        let acceptor = acceptor(&certificate, &key)?;
        Ok(Self { certificate, key, current: RwLock::new(Current { written, acceptor }) })
    }

    /// Returns an acceptor with the newest certificate. If the new files cannot be used, the last ones stay in use.
    pub fn acceptor(&self) -> TlsAcceptor {
        let written = written(&self.certificate, &self.key);
        let current = self.current.read().unwrap_or_else(PoisonError::into_inner);
        if current.written == written {
            return current.acceptor.clone();
        }
        drop(current);
        let mut current = self.current.write().unwrap_or_else(PoisonError::into_inner);
        if current.written != written {
            current.written = written;
            match acceptor(&self.certificate, &self.key) {
                Ok(acceptor) => {
                    tracing::info!(certificate = %self.certificate.display(), "new certificate in use");
                    current.acceptor = acceptor;
                }
                Err(error) => tracing::error!(%error, "new certificate not used: the last one stays in use"),
            }
        }
        current.acceptor.clone()
    }
}

fn written(certificate: &Path, key: &Path) -> Written {
    [certificate, key].map(|path| fs::metadata(path).and_then(|metadata| metadata.modified()).ok())
}

/// Reads a certificate and its key. TLS 1.2 and 1.3 are spoken, with the cipher suites of rustls, which are all strong.
fn acceptor(certificate: &Path, key: &Path) -> Result<TlsAcceptor, TlsError> {
    let read = |path: &Path| fs::read(path).map_err(|cause| TlsError::File { path: path.to_owned(), cause });
    let pem = |path: &Path| {
        let path = path.to_owned();
        move |cause| TlsError::Pem { path, cause }
    };
    let chain = CertificateDer::pem_slice_iter(&read(certificate)?).collect::<Result<Vec<_>, _>>();
    let chain = chain.map_err(pem(certificate))?;
    let private = PrivateKeyDer::from_pem_slice(&read(key)?).map_err(pem(key))?;
    let unusable = |cause| TlsError::Unusable { certificate: certificate.to_owned(), key: key.to_owned(), cause };
    let mut config = ServerConfig::builder_with_provider(Arc::new(default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(unusable)?
        .with_no_client_auth()
        .with_single_cert(chain, private)
        .map_err(unusable)?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_file_is_named_with_its_cause() {
        let directory = std::env::temp_dir().join(format!("wsg-tls-{}", std::process::id()));
        fs::create_dir_all(&directory).unwrap();
        let [certificate, key] = ["certificate.pem", "key.pem"].map(|name| directory.join(name));
        let said = || Tls::new(certificate.clone(), key.clone()).unwrap_err().to_string();
        assert!(said().contains("certificate.pem: No such file"), "{}", said());
        let pair = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        fs::write(&certificate, pair.cert.pem()).unwrap();
        fs::write(&key, "nonsense").unwrap();
        assert!(said().contains("key.pem has no certificate or key"), "{}", said());
        let other = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        fs::write(&key, other.signing_key.serialize_pem()).unwrap();
        assert!(said().contains("cannot be used together"), "{}", said());
        fs::write(&key, pair.signing_key.serialize_pem()).unwrap();
        Tls::new(certificate, key).unwrap();
        fs::remove_dir_all(directory).unwrap();
    }
}
