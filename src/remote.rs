//! Requests to a remote vehicle: `--remote VEHICLE --connect ENDPOINT --keys FOLDER`.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use clap::Args;
use control::{Diagnostic, ServiceStatus, SwapReport, swap_answer::from_answer};
use link::{
    Endpoints, Link, LinkError,
    endpoints::{Tls, is_secured},
};
use wire::{
    command::ControlMessage,
    keys,
    v1::{self, Services, SwapAnswer, SwapRequest},
};

/// Timeout for connecting to the endpoint.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Timeout for the reply to a request that is answered immediately.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(5);
/// Time from a swap request to its deadline.
const SWAP_TIMEOUT: Duration = Duration::from_secs(30);
/// Default endpoint, at which a gateway on this machine listens.
const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// Error of a request to a remote vehicle.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RemoteError {
    /// The network failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// A QUIC endpoint needs certificates, but no key folder was given.
    #[error(
        "--keys is missing: {endpoint} requires a certificate; create a folder with `plumb keys operator NAME` or `plumb keys viewer NAME`"
    )]
    NoKeys { endpoint: String },
    /// The key folder is incomplete.
    #[error(
        "no {file} in {folder}: --keys expects a folder created by `plumb keys operator NAME` or `plumb keys viewer NAME`"
    )]
    NoFile { folder: PathBuf, file: &'static str },
    /// The vehicle responds to queries but not to this client's commands.
    #[error(
        "vehicle {vehicle:?} takes no command from this client: its access list requires the certificate of an operator, --keys keys/operator.NAME"
    )]
    ReadOnly { vehicle: String },
    /// Commands need a certificate, which a plain endpoint does not have.
    #[error(
        "vehicle {vehicle:?} takes no command over {endpoint}, which is read-only because it has no certificates; run `plumb swap {slot} {stage}` on the vehicle, or use a quic/ endpoint with the certificate of an operator, --keys keys/operator.NAME (docs/how-to/secure.md)"
    )]
    PlainReadOnly { vehicle: String, endpoint: String, slot: String, stage: String },
}

impl RemoteError {
    /// Returns the exit code of `plumb`: 2 for a usage error, else 1.
    pub(crate) fn exit_code(&self) -> u8 {
        if matches!(self, Self::NoKeys { .. } | Self::NoFile { .. } | Self::Link(LinkError::Ipv6 { .. })) {
            2
        } else {
            1
        }
    }
}

/// Command-line arguments that select the endpoint of remote vehicles.
#[derive(Args, Clone)]
pub(crate) struct RemoteEndpoint {
    /// Gateway or router endpoint, repeatable [default: tcp/127.0.0.1:7447]
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,
    /// Folder made by `plumb keys` with the certificate for quic/ endpoints
    #[arg(long, value_name = "FOLDER")]
    keys: Option<PathBuf>,
}

impl RemoteEndpoint {
    /// Returns `true` if both ends present certificates, so that commands are accepted.
    #[cfg_attr(not(feature = "cockpit"), allow(dead_code, reason = "only the cockpit uses it"))]
    pub(crate) fn is_secured(&self) -> bool {
        self.keys.is_some() && self.endpoints().iter().all(|endpoint| is_secured(endpoint))
    }

    fn endpoints(&self) -> Vec<String> {
        if self.connect.is_empty() { vec![DEFAULT_ENDPOINT.to_owned()] } else { self.connect.clone() }
    }

    /// Returns the error for a command that is rejected by a vehicle that responds to queries.
    fn read_only_error(&self, vehicle: &str, request: &SwapRequest) -> RemoteError {
        let (vehicle, SwapRequest { slot, stage, .. }) = (vehicle.into(), request.clone());
        match self.endpoints().into_iter().find(|endpoint| !is_secured(endpoint)) {
            Some(endpoint) => RemoteError::PlainReadOnly { vehicle, endpoint, slot, stage },
            None => RemoteError::ReadOnly { vehicle },
        }
    }

    fn link_endpoints(&self) -> Result<Endpoints, RemoteError> {
        let connect = &self.endpoints()[..];
        let secured = connect.iter().find(|endpoint| is_secured(endpoint));
        let tls = match (&self.keys, secured) {
            (Some(folder), _) => Some(tls(folder)?),
            (None, Some(endpoint)) => return Err(RemoteError::NoKeys { endpoint: endpoint.clone() }),
            (None, None) => None,
        };
        Ok(Endpoints { tls, ..Endpoints::with_connect(connect) })
    }

    /// Connects as a Zenoh client. A router forwards to a client everything that the client
    /// subscribes to.
    pub(crate) fn open_as_client(&self) -> Result<Link, RemoteError> {
        let endpoints = Endpoints { client: true, ..self.link_endpoints()? };
        endpoints.check_certificates()?;
        Ok(Link::connect(&endpoints, CONNECT_TIMEOUT)?)
    }

    /// Connects as a client if there is a single, secured endpoint; otherwise as a Zenoh peer.
    pub(crate) fn open(&self) -> Result<Link, RemoteError> {
        let endpoints = self.link_endpoints()?;
        endpoints.check_certificates()?;
        Ok(Link::connect(&endpoints, CONNECT_TIMEOUT)?)
    }
}

/// Returns the paths of the certificate files in a party's folder.
fn tls(folder: &Path) -> Result<Tls, RemoteError> {
    let file = |file| {
        let path = folder.join(file);
        if path.is_file() { Ok(path) } else { Err(RemoteError::NoFile { folder: folder.into(), file }) }
    };
    Ok(Tls { ca: file("ca.pem")?, cert: file("cert.pem")?, key: file("key.pem")? })
}

/// Returns the status of a vehicle's services.
pub(crate) fn ps(vehicle: &str, endpoint: &RemoteEndpoint) -> Result<Vec<ServiceStatus>, RemoteError> {
    services(&endpoint.open()?, vehicle)
}

/// Returns the status of a vehicle's services, over an open link.
pub(crate) fn services(link: &Link, vehicle: &str) -> Result<Vec<ServiceStatus>, RemoteError> {
    Ok(query_services(link, vehicle)?.services.into_iter().map(status).collect())
}

/// Swaps the stage of a slot of a vehicle.
pub(crate) fn swap(
    vehicle: &str,
    endpoint: &RemoteEndpoint,
    slot: &str,
    stage: launch::StageConfig,
) -> Result<SwapReport, RemoteError> {
    swap_over(&endpoint.open()?, vehicle, endpoint, slot, stage)
}

/// Swaps the stage of a slot of a vehicle, over an open link.
pub(crate) fn swap_over(
    link: &Link,
    vehicle: &str,
    endpoint: &RemoteEndpoint,
    slot: &str,
    stage: launch::StageConfig,
) -> Result<SwapReport, RemoteError> {
    let Services { t_now_ns, services } = query_services(link, vehicle)?;
    let status = services.into_iter().find(|one| one.service == slot);
    // For an unknown slot the epoch does not matter, because the vehicle rejects the request with
    // its own message.
    let expected_epoch = status.map_or(1, |one| one.epoch).max(1);
    let request = SwapRequest {
        request_id: request_id(),
        slot: slot.into(),
        stage: stage.stage,
        set: stage.set,
        expected_epoch,
        t_deadline_ns: t_now_ns + SWAP_TIMEOUT.as_nanos() as u64,
    };
    let started = Instant::now();
    let reply: Result<SwapAnswer, _> =
        link.query_one(&keys::key(vehicle, keys::SWAP), request.to_bytes(), SWAP_TIMEOUT + RESPONSE_TIMEOUT);
    match reply {
        Ok(answer) => Ok(from_answer(answer)),
        // The vehicle has just responded, so an immediate failure means that an access list denied
        // the query.
        Err(LinkError::NoResponse { .. }) if started.elapsed() < SWAP_TIMEOUT => {
            Err(endpoint.read_only_error(vehicle, &request))
        }
        Err(error) => Err(error.into()),
    }
}

fn query_services(link: &Link, vehicle: &str) -> Result<Services, LinkError> {
    link.query_one(&keys::key(vehicle, keys::SERVICES), Vec::new(), RESPONSE_TIMEOUT)
}

/// Returns a unique request id, composed of process id and time.
fn request_id() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    format!("{}-{:x}", std::process::id(), since.as_nanos())
}

fn status(status: v1::ServiceStatus) -> ServiceStatus {
    let v1::ServiceStatus { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, at, troubles } =
        status;
    let non_empty = |text: String| Some(text).filter(|text| !text.is_empty());
    let pid = Some(pid).filter(|pid| *pid != 0);
    let diagnostic = |v1::Trouble { kind, found, remedy }| Diagnostic { kind, found, remedy };
    let diagnostics = troubles.into_iter().map(diagnostic).collect();
    ServiceStatus {
        service,
        stage: non_empty(stage),
        state,
        pid,
        restarts,
        incarnation,
        epoch,
        ticks,
        lost,
        address: non_empty(at),
        diagnostics,
    }
}
