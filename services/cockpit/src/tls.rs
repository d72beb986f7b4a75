//! TLS, for whoever looks from another machine.

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

/// Why the page cannot be served by TLS.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// The certificate does not serve.
    #[error(transparent)]
    Certificate(#[from] KeysError),
    /// A file cannot be read, or holds something else.
    #[error("reading {path} for the cockpit's TLS: {cause}")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        cause: pem::Error,
    },
    /// A private key that others can read.
    #[error("reading {path} for the cockpit's TLS: others can read it; `chmod 600` it, or make another")]
    Open {
        /// The file.
        path: PathBuf,
    },
    /// The two do not belong together.
    #[error("serving {cert} with {key}: {cause}; `plumb keys vehicle NAME --host HOST` makes both")]
    Pair {
        /// The certificate.
        cert: PathBuf,
        /// The private key.
        key: PathBuf,
        /// What is wrong.
        cause: rustls::Error,
    },
    /// The library has not what is needed.
    #[error("beginning the cockpit's TLS: {0}")]
    Begin(rustls::Error),
}

/// Accepts connections with the certificate of these files, TLS 1.3.
pub(crate) fn acceptor(CockpitTls { cert, key }: &CockpitTls) -> Result<TlsAcceptor, TlsError> {
    keys::validity::check(cert)?;
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |cause| TlsError::File { path, cause }
    };
    let chain: Vec<_> = CertificateDer::pem_file_iter(cert).and_then(Iterator::collect).map_err(failed(cert))?;
    if is_open(key).map_err(|cause| TlsError::File { path: key.clone(), cause: pem::Error::Io(cause) })? {
        return Err(TlsError::Open { path: key.clone() });
    }
    let private = PrivateKeyDer::from_pem_file(key).map_err(failed(key))?;
    let builder = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let builder = builder.with_protocol_versions(&[&TLS13]).map_err(TlsError::Begin)?;
    let config = builder.with_no_client_auth().with_single_cert(chain, private);
    let config = config.map_err(|cause| TlsError::Pair { cert: cert.clone(), key: key.clone(), cause })?;
    Ok(TlsAcceptor::from(Arc::new(config)))
}

/// Others than the owner and its group can read a file.
fn is_open(path: &Path) -> io::Result<bool> {
    use std::os::unix::fs::PermissionsExt as _;
    Ok(path.metadata()?.permissions().mode() & 0o007 != 0)
}
