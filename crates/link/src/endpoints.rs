//! The endpoints, and what secures them.

use std::{
    fmt,
    net::TcpListener,
    path::{Path, PathBuf},
};

use keys::access::AccessList;
use zenoh::Config;

use crate::{LinkError, guard};

/// How the hosts of the loopback begin.
const LOOPBACKS: [&str; 3] = ["127.", "localhost:", "[::1]:"];
/// Ports tried after the one named.
const PORTS_TRIED: u16 = 64;

/// From the last sign of a neighbour until it counts as gone, ms. QUIC does not tell that a process at the other end has died.
const LEASE_MS: &str = "3000";
/// How an endpoint with mutual TLS begins.
const SECURED: &str = "quic/";

/// When whoever only connects tries again, ms: a few times while a gateway is busy with connections that never become sessions.
const RETRY: &str = "{ period_init_ms: 200, period_max_ms: 1000, period_increase_factor: 1.5 }";

/// The endpoints, and what secures them.
#[derive(Debug, Clone, Default)]
pub struct Endpoints {
    /// Where others may connect.
    pub listen: Vec<String>,
    /// Whom to connect to.
    pub connect: Vec<String>,
    /// The certificates of mutual TLS.
    pub tls: Option<Tls>,
    /// A file with Zenoh's `access_control`.
    pub access: Option<PathBuf>,
    /// What those may do who show no certificate, and whoever that list names; everything where there is none.
    pub plain: Option<AccessList>,
    /// A client: it sees through a router whom it is for, which from one peer to another hands nothing, and does not open where nobody
    /// is.
    pub client: bool,
}

/// The certificates of mutual TLS, PEM.
#[derive(Debug, Clone)]
pub struct Tls {
    /// Of the authority.
    pub ca: PathBuf,
    /// One's own.
    pub cert: PathBuf,
    /// The key to it.
    pub key: PathBuf,
}

impl Endpoints {
    /// Those whom somebody elsewhere connects to.
    pub fn connecting(endpoints: &[String]) -> Self {
        // On the board itself there is no router.
        let client = matches!(endpoints, [one] if is_secured(one));
        Self { connect: endpoints.to_vec(), client, ..Self::default() }
    }

    /// Those whom it connects to, and nobody connects to it.
    pub fn calling(&self) -> Self {
        Self { listen: vec![], access: None, plain: None, ..self.clone() }
    }

    /// The same with the next free port where one of the loopback is taken.
    pub fn with_free_ports(mut self) -> Result<Self, LinkError> {
        for endpoint in &mut self.listen {
            let address = endpoint.strip_prefix("tcp/").filter(|it| LOOPBACKS.iter().any(|host| it.starts_with(host)));
            if let Some(address) = address {
                *endpoint = format!("tcp/{}", free(address)?);
            }
        }
        Ok(self)
    }

    /// One's own certificates serve now. Who is shown one that does not will not say so.
    pub fn check(&self) -> Result<(), LinkError> {
        let files = self.tls.iter().flat_map(|tls| [&tls.ca, &tls.cert]);
        Ok(files.map(PathBuf::as_path).try_for_each(keys::validity::check)?)
    }

    /// Some of what it speaks to is beyond this machine.
    pub(crate) fn are_secured(&self) -> bool {
        self.listen.iter().chain(&self.connect).any(|endpoint| is_secured(endpoint))
    }

    pub(crate) fn config(&self) -> Result<Config, LinkError> {
        if let Some(endpoint) = self.connect.iter().find(|endpoint| is_unreachable(endpoint)) {
            return Err(LinkError::Ipv6 { endpoint: endpoint.clone() });
        }
        let mut config = Config::default();
        let mut set = |key: &'static str, value: String| {
            let failed = |cause: zenoh::Error| LinkError::Config { what: key, cause: cause.to_string() };
            config.insert_json5(key, &value).map_err(failed)
        };
        let client = self.client;
        set("mode", quoted(if client { "client" } else { "peer" }))?;
        set("listen/endpoints", list(&self.listen))?;
        set("connect/endpoints", list(&self.connect))?;
        // A client tries once; `Link::open` tries again.
        set("connect/timeout_ms", if client { "0" } else { "-1" }.into())?;
        set("connect/exit_on_failure", client.to_string())?;
        set("scouting/multicast/enabled", "false".into())?;
        set("scouting/gossip/enabled", "false".into())?;
        if self.are_secured() {
            set("transport/link/tx/lease", LEASE_MS.into())?;
        }
        set(guard::MESSAGE_MAX.0, guard::MESSAGE_MAX.1.into())?;
        if self.listen.is_empty() {
            set("connect/retry", RETRY.into())?;
        } else {
            guard::limits().into_iter().try_for_each(|(key, value)| set(key, value))?;
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
        if let Some(list) = guard::access_control(self.access.as_deref(), self.plain.as_ref())? {
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

/// It speaks QUIC, with mutual TLS.
pub fn is_secured(endpoint: &str) -> bool {
    endpoint.starts_with(SECURED)
}

/// It names whom to connect to by an IPv6 address, which Zenoh's QUIC takes for a name and refuses.
fn is_unreachable(endpoint: &str) -> bool {
    let host = endpoint.strip_prefix(SECURED).and_then(|address| address.rsplit_once(':'));
    host.is_some_and(|(host, _)| host.contains(':'))
}

/// The address with the first port from the one named on that nobody has.
fn free(address: &str) -> Result<String, LinkError> {
    let none = || LinkError::NoPort { endpoint: format!("tcp/{address}"), tried: PORTS_TRIED };
    let (host, port) = address.rsplit_once(':').ok_or_else(none)?;
    let port: u16 = port.parse().map_err(|_| none())?;
    let is_free = |port: &u16| TcpListener::bind(format!("{host}:{port}")).is_ok();
    let port = (port..=port.saturating_add(PORTS_TRIED)).find(is_free).ok_or_else(none)?;
    Ok(format!("{host}:{port}"))
}

fn quoted(text: &str) -> String {
    // Paths and endpoints as a JSON string.
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

fn path(path: &Path) -> String {
    quoted(&path.to_string_lossy())
}

fn list(endpoints: &[String]) -> String {
    let quoted: Vec<_> = endpoints.iter().map(|endpoint| quoted(endpoint)).collect();
    format!("[{}]", quoted.join(", "))
}
