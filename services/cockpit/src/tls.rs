//! TLS for clients on other machines.

use std::{
    io,
    path::{Path, PathBuf},
    sync::Arc,
};

use keys::KeysError;
use launch::CockpitTls;
use tokio_rustls::{
    TlsAcceptor,
    rustls::{
        self, ServerConfig,
        crypto::ring,
        pki_types::{
            CertificateDer, PrivateKeyDer,
            pem::{self, PemObject as _},
        },
        version::TLS13,
    },
};

/// Error of the TLS configuration.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// The certificate is not valid.
    #[error(transparent)]
    Certificate(#[from] KeysError),
    /// A file cannot be read or is not in PEM format.
    #[error("cannot read {path} for the cockpit's TLS: {cause}", path = foreign::path(path))]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Cause of the failure.
        cause: pem::Error,
    },
    /// The private key is readable by other users.
    #[error("private key {path} is readable by other users; run `chmod 600 {path}` or create a new key", path = foreign::path(path))]
    ReadableKey {
        /// Path of the private key.
        path: PathBuf,
    },
    /// The private key does not belong to the certificate.
    #[error(
        "cannot use certificate {cert} with private key {key}: {cause}; `plumb keys vehicle NAME --host HOST` creates a matching pair", key = foreign::path(key), cert = foreign::path(cert)
    )]
    KeyMismatch {
        /// Path of the certificate.
        cert: PathBuf,
        /// Path of the private key.
        key: PathBuf,
        /// Cause of the failure.
        cause: rustls::Error,
    },
    /// The TLS library does not support the required version.
    #[error("cannot set up TLS for the cockpit: {0}")]
    Setup(rustls::Error),
}

/// Creates an acceptor for TLS 1.3 from the given certificate and private key files.
pub(crate) fn acceptor(CockpitTls { cert, key }: &CockpitTls) -> Result<TlsAcceptor, TlsError> {
    keys::validity::check(cert)?;
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |cause| TlsError::File { path, cause }
    };
    let chain: Vec<_> = CertificateDer::pem_file_iter(cert).and_then(Iterator::collect).map_err(failed(cert))?;
    if is_readable_by_others(key).map_err(|cause| TlsError::File { path: key.clone(), cause: pem::Error::Io(cause) })? {
        return Err(TlsError::ReadableKey { path: key.clone() });
    }
    let private = PrivateKeyDer::from_pem_file(key).map_err(failed(key))?;
    let builder = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let builder = builder.with_protocol_versions(&[&TLS13]).map_err(TlsError::Setup)?;
    let config = builder.with_no_client_auth().with_single_cert(chain, private);
    let config = config.map_err(|cause| TlsError::KeyMismatch { cert: cert.clone(), key: key.clone(), cause })?;
    Ok(TlsAcceptor::from(Arc::new(config)))
}

/// Returns `true` if the file permissions allow any access by users that are neither the owner nor
/// in the group.
fn is_readable_by_others(path: &Path) -> io::Result<bool> {
    use std::os::unix::fs::PermissionsExt as _;
    Ok(path.metadata()?.permissions().mode() & 0o007 != 0)
}
