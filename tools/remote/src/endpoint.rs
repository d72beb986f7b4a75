//! Endpoint of remote vehicles and the client's certificate.

use std::{
    fmt,
    path::{Path, PathBuf},
    time::Duration,
};

use link::{
    Endpoints, Link,
    endpoints::{Tls, is_secured},
};

use crate::error::RemoteError;

/// Timeout for connecting.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Endpoints of gateways or routers, and the client's certificate.
#[derive(Debug, Clone)]
pub struct RemoteEndpoint {
    endpoints: Vec<String>,
    /// Folder with the certificate, as created by `plumb keys`.
    keys: Option<PathBuf>,
}

impl RemoteEndpoint {
    /// Creates the description of an endpoint.
    pub fn new(endpoints: &[String], keys: Option<&Path>) -> Self {
        Self { endpoints: endpoints.to_vec(), keys: keys.map(Path::to_owned) }
    }

    /// Returns `true` if both ends present certificates, so that commands are accepted.
    pub fn is_secured(&self) -> bool {
        self.keys.is_some() && self.plain().is_none()
    }

    /// Returns the first endpoint that uses no certificates, or `None` if all endpoints use them.
    pub(crate) fn plain(&self) -> Option<&str> {
        self.endpoints.iter().map(String::as_str).find(|endpoint| !is_secured(endpoint))
    }

    /// Connects as a Zenoh client. A router forwards to a client everything that the client
    /// subscribes to.
    ///
    /// # Errors
    ///
    /// Fails if the certificate is missing or invalid, or no connection is established.
    pub fn open_as_client(&self) -> Result<Link, RemoteError> {
        connect(&Endpoints { client: true, ..self.link_endpoints()? })
    }

    /// Connects as a client if there is a single, secured endpoint; otherwise as a Zenoh peer.
    ///
    /// # Errors
    ///
    /// Fails if the certificate is missing or invalid, or no connection is established.
    pub fn open(&self) -> Result<Link, RemoteError> {
        connect(&self.link_endpoints()?)
    }

    fn link_endpoints(&self) -> Result<Endpoints, RemoteError> {
        let secured = self.endpoints.iter().find(|endpoint| is_secured(endpoint));
        let tls = match (&self.keys, secured) {
            (Some(folder), _) => Some(tls(folder)?),
            (None, Some(endpoint)) => return Err(RemoteError::NoKeys { endpoint: endpoint.clone() }),
            (None, None) => None,
        };
        Ok(Endpoints { tls, ..Endpoints::with_connect(&self.endpoints) })
    }
}

impl fmt::Display for RemoteEndpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.endpoints.join(", "))
    }
}

fn connect(endpoints: &Endpoints) -> Result<Link, RemoteError> {
    endpoints.check_certificates()?;
    Ok(Link::connect(endpoints, CONNECT_TIMEOUT)?)
}

/// Returns the paths of the certificate files in a party's folder.
fn tls(folder: &Path) -> Result<Tls, RemoteError> {
    let file = |file| {
        let path = folder.join(file);
        if path.is_file() { Ok(path) } else { Err(RemoteError::NoFile { folder: folder.into(), file }) }
    };
    Ok(Tls { ca: file("ca.pem")?, cert: file("cert.pem")?, key: file("key.pem")? })
}
