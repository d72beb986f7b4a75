//! Network endpoints and their security.

use std::{
    fmt,
    net::TcpListener,
    path::{Path, PathBuf},
};

use keys::access::AccessList;
use zenoh::Config;

use crate::{admission, error::LinkError};

/// Prefixes of loopback addresses.
const LOOPBACK_PREFIXES: [&str; 3] = ["127.", "localhost:", "[::1]:"];
/// Number of ports tried after the configured one.
const MAX_EXTRA_PORTS: u16 = 64;

/// Time in ms without any message after which a peer counts as disconnected. This limit is needed
/// because QUIC does not report that a remote process has died.
const LEASE_MS: &str = "3000";
/// Prefix of endpoints with mutual TLS.
const SECURED_PREFIX: &str = "quic/";

/// Retry intervals in ms of a session that only connects. They are short, because a gateway may
/// be busy with connections that never become sessions, and accept only a later attempt.
const RETRY_CONFIG: &str = "{ period_init_ms: 200, period_max_ms: 1000, period_increase_factor: 1.5 }";

/// Endpoints of a session and their security.
#[derive(Debug, Clone, Default)]
pub struct Endpoints {
    /// Endpoints to listen on.
    pub listen: Vec<String>,
    /// Endpoints to connect to.
    pub connect: Vec<String>,
    /// Certificates for mutual TLS.
    pub tls: Option<Tls>,
    /// File with Zenoh's `access_control` settings.
    pub access: Option<PathBuf>,
    /// Permissions of clients without a certificate and of the clients named in the access list;
    /// `None` for no restriction.
    pub plain_access: Option<AccessList>,
    /// `true` for a client session, which reaches vehicles through a router. Peers cannot do this,
    /// because a router does not forward between peers. A client session cannot be opened while its
    /// endpoint is unreachable.
    pub client: bool,
}

/// PEM files for mutual TLS.
#[derive(Debug, Clone)]
pub struct Tls {
    /// Certificate of the authority.
    pub ca: PathBuf,
    /// Certificate of this program.
    pub cert: PathBuf,
    /// Private key of the certificate.
    pub key: PathBuf,
}

impl Endpoints {
    /// Creates the endpoints of a remote program that only connects.
    pub fn with_connect(endpoints: &[String]) -> Self {
        // A plain endpoint is on the board itself, which has no router, so the session is a peer.
        let client = matches!(endpoints, [one] if is_secured(one));
        Self { connect: endpoints.to_vec(), client, ..Self::default() }
    }

    /// Returns the endpoints to connect to, without those to listen on.
    pub fn connect_only(&self) -> Self {
        Self { listen: vec![], access: None, plain_access: None, ..self.clone() }
    }

    /// Moves each loopback listener to the next free port if its own port is already in use.
    ///
    /// # Errors
    ///
    /// Fails if no free port is found.
    pub fn with_free_ports(mut self) -> Result<Self, LinkError> {
        for endpoint in &mut self.listen {
            let address =
                endpoint.strip_prefix("tcp/").filter(|it| LOOPBACK_PREFIXES.iter().any(|host| it.starts_with(host)));
            if let Some(address) = address {
                *endpoint = format!("tcp/{}", with_free_port(address)?);
            }
        }
        Ok(self)
    }

    /// Checks that the certificates of this program are currently valid. This is checked here,
    /// because the remote side does not report an invalid certificate.
    pub fn check_certificates(&self) -> Result<(), LinkError> {
        let files = self.tls.iter().flat_map(|tls| [&tls.ca, &tls.cert]);
        Ok(files.map(PathBuf::as_path).try_for_each(keys::validity::check)?)
    }

    /// Returns `true` if any endpoint uses mutual TLS, which connections to other machines require.
    pub(crate) fn are_secured(&self) -> bool {
        self.listen.iter().chain(&self.connect).any(|endpoint| is_secured(endpoint))
    }

    pub(crate) fn config(&self) -> Result<Config, LinkError> {
        if let Some(endpoint) = self.connect.iter().find(|endpoint| is_secured_ipv6(endpoint)) {
            return Err(LinkError::Ipv6 { endpoint: endpoint.clone() });
        }
        let mut config = Config::default();
        let mut set = |key: &'static str, value: String| {
            let failed = |cause: zenoh::Error| LinkError::Config { what: key, cause: cause.to_string().into() };
            config.insert_json5(key, &value).map_err(failed)
        };
        let client = self.client;
        set("mode", json_string(if client { "client" } else { "peer" }))?;
        set("listen/endpoints", list(&self.listen))?;
        set("connect/endpoints", list(&self.connect))?;
        // For a client, Zenoh makes a single attempt, because `Link::open` repeats the attempts.
        set("connect/timeout_ms", if client { "0" } else { "-1" }.into())?;
        set("connect/exit_on_failure", client.to_string())?;
        set("scouting/multicast/enabled", "false".into())?;
        set("scouting/gossip/enabled", "false".into())?;
        if self.are_secured() {
            set("transport/link/tx/lease", LEASE_MS.into())?;
        }
        set(admission::MAX_MESSAGE.0, admission::MAX_MESSAGE.1.into())?;
        if self.listen.is_empty() {
            set("connect/retry", RETRY_CONFIG.into())?;
        } else {
            admission::connection_limits().into_iter().try_for_each(|(key, value)| set(key, value))?;
        }
        if let Some(Tls { ca, cert, key }) = &self.tls {
            set("transport/link/tls/enable_mtls", "true".into())?;
            set("transport/link/tls/root_ca_certificate", path(ca))?;
            for side in ["listen", "connect"] {
                let [certificate, private_key] = match side {
                    "listen" => ["transport/link/tls/listen_certificate", "transport/link/tls/listen_private_key"],
                    _ => ["transport/link/tls/connect_certificate", "transport/link/tls/connect_private_key"],
                };
                set(certificate, path(cert))?;
                set(private_key, path(key))?;
            }
        }
        if let Some(list) = admission::access_control(self.access.as_deref(), self.plain_access.as_ref())? {
            set("access_control", list.to_string())?;
        }
        Ok(config)
    }
}

impl fmt::Display for Endpoints {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all: Vec<_> = self.listen.iter().chain(&self.connect).map(String::as_str).collect();
        f.write_str(&all.join(", "))
    }
}

/// Returns `true` if the endpoint uses QUIC with mutual TLS.
pub fn is_secured(endpoint: &str) -> bool {
    endpoint.starts_with(SECURED_PREFIX)
}

/// Returns `true` for an IPv6 address over QUIC, which Zenoh mistakes for a host name and rejects.
fn is_secured_ipv6(endpoint: &str) -> bool {
    let host = endpoint.strip_prefix(SECURED_PREFIX).and_then(|address| address.rsplit_once(':'));
    host.is_some_and(|(host, _)| host.contains(':'))
}

/// Returns the address with the first free port, starting from the given one.
fn with_free_port(address: &str) -> Result<String, LinkError> {
    let no_free_port = || LinkError::NoFreePort { endpoint: format!("tcp/{address}"), tried: MAX_EXTRA_PORTS };
    let (host, port) = address.rsplit_once(':').ok_or_else(no_free_port)?;
    let port: u16 = port.parse().map_err(|_| no_free_port())?;
    let is_free = |port: &u16| TcpListener::bind(format!("{host}:{port}")).is_ok();
    let port = (port..=port.saturating_add(MAX_EXTRA_PORTS)).find(is_free).ok_or_else(no_free_port)?;
    Ok(format!("{host}:{port}"))
}

fn json_string(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

fn path(path: &Path) -> String {
    json_string(&path.to_string_lossy())
}

fn list(endpoints: &[String]) -> String {
    let quoted: Vec<_> = endpoints.iter().map(|endpoint| json_string(endpoint)).collect();
    format!("[{}]", quoted.join(", "))
}
