//! A vehicle that is asked from elsewhere: `--remote VEHICLE --connect ENDPOINT --keys FOLDER`.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use clap::Args;
use control::{SwapOutcome, ServiceStatus, SwapReport, Diagnostic};
use link::{
    Endpoints, Link, LinkError,
    endpoints::{Tls, is_secured},
};
use wire::{
    command::ControlMessage,
    keys,
    v1::{self, Services, SwapAnswer, SwapRequest, swap_answer},
};

/// How long somebody who is to be connected to is waited for.
const CONNECT_LIMIT: Duration = Duration::from_secs(5);
/// The same for an answer that takes no time.
const ANSWER_LIMIT: Duration = Duration::from_secs(5);
/// For how long a swap may be under way.
const SWAP_LIMIT: Duration = Duration::from_secs(30);
/// Where a gateway listens when nothing else is said.
const USUAL: &str = "tcp/127.0.0.1:7447";

/// Why a vehicle elsewhere was not asked, or did not answer.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RemoteError {
    /// The network.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// A connection that somebody must be trusted for, and nobody is.
    #[error(
        "connecting to {endpoint}: --keys is missing, the folder that `plumb keys operator NAME` or `plumb keys viewer NAME` makes"
    )]
    NoKeys { endpoint: String },
    /// The folder is not one of those.
    #[error(
        "reading the keys of {folder}: there is no {file}; `plumb keys operator NAME` or `plumb keys viewer NAME` makes such a folder"
    )]
    NoFile { folder: PathBuf, file: &'static str },
    /// Whoever tells how it is, and takes no command.
    #[error(
        "commanding {vehicle:?}: it tells how its services are and takes no command from here, as its access list has it for viewers; with the folder of an operator, --keys keys/operator.NAME, it does"
    )]
    NoCommand { vehicle: String },
    /// An endpoint at which anybody could be anybody.
    #[error(
        "commanding {vehicle:?}: over {endpoint}, where nobody shows a certificate, one may look and not command; on that machine, as the user who runs it, `plumb swap {slot} {stage}` does; from elsewhere a quic/ endpoint and the folder of an operator, --keys keys/operator.NAME: docs/security.md"
    )]
    PlainLooksOnly { vehicle: String, endpoint: String, slot: String, stage: String },
}

impl RemoteError {
    /// The exit code of `plumb`: 2 when the command line is wrong, else 1.
    pub(crate) fn exit_code(&self) -> u8 {
        if matches!(self, Self::NoKeys { .. } | Self::NoFile { .. } | Self::Link(LinkError::Ipv6 { .. })) {
            2
        } else {
            1
        }
    }
}

/// How vehicles are reached.
#[derive(Args, Clone)]
pub(crate) struct Way {
    /// An endpoint of a gateway or a router; may be given several times [default: tcp/127.0.0.1:7447].
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,
    /// A folder that `plumb keys` has made, for quic endpoints: the certificate that is shown, and whom it believes.
    #[arg(long, value_name = "FOLDER")]
    keys: Option<PathBuf>,
}

impl Way {
    /// Whoever is reached shows a certificate, and is shown one: commands can be taken from here.
    pub(crate) fn is_secured(&self) -> bool {
        self.keys.is_some() && self.endpoints().iter().all(|endpoint| is_secured(endpoint))
    }

    fn endpoints(&self) -> Vec<String> {
        if self.connect.is_empty() { vec![USUAL.to_owned()] } else { self.connect.clone() }
    }

    /// Why a vehicle that answers takes no command.
    fn no_command(&self, vehicle: &str, request: &SwapRequest) -> RemoteError {
        let (vehicle, SwapRequest { slot, stage, .. }) = (vehicle.into(), request.clone());
        match self.endpoints().into_iter().find(|endpoint| !is_secured(endpoint)) {
            Some(endpoint) => RemoteError::PlainLooksOnly { vehicle, endpoint, slot, stage },
            None => RemoteError::NoCommand { vehicle },
        }
    }

    fn ends(&self) -> Result<Endpoints, RemoteError> {
        let connect = &self.endpoints()[..];
        let secured = connect.iter().find(|endpoint| is_secured(endpoint));
        let tls = match (&self.keys, secured) {
            (Some(folder), _) => Some(tls(folder)?),
            (None, Some(endpoint)) => return Err(RemoteError::NoKeys { endpoint: endpoint.clone() }),
            (None, None) => None,
        };
        Ok(Endpoints { tls, ..Endpoints::with_connect(connect) })
    }

    /// The way, gone as a client, to whom a router hands whatever there is.
    pub(crate) fn open_as_client(&self) -> Result<Link, RemoteError> {
        let ends = Endpoints { client: true, ..self.ends()? };
        ends.check_certificates()?;
        Ok(Link::connect(&ends, CONNECT_LIMIT)?)
    }

    /// The way, gone.
    pub(crate) fn open(&self) -> Result<Link, RemoteError> {
        let ends = self.ends()?;
        ends.check_certificates()?;
        Ok(Link::connect(&ends, CONNECT_LIMIT)?)
    }
}

/// What a party's folder holds.
fn tls(folder: &Path) -> Result<Tls, RemoteError> {
    let file = |file| {
        let path = folder.join(file);
        if path.is_file() { Ok(path) } else { Err(RemoteError::NoFile { folder: folder.into(), file }) }
    };
    Ok(Tls { ca: file("ca.pem")?, cert: file("cert.pem")?, key: file("key.pem")? })
}

/// The services of a vehicle.
pub(crate) fn ps(vehicle: &str, way: &Way) -> Result<Vec<ServiceStatus>, RemoteError> {
    services(&way.open()?, vehicle)
}

/// The same over a link that there is.
pub(crate) fn services(link: &Link, vehicle: &str) -> Result<Vec<ServiceStatus>, RemoteError> {
    Ok(asked(link, vehicle)?.services.into_iter().map(status).collect())
}

/// Swaps what fills a slot of a vehicle.
pub(crate) fn swap(vehicle: &str, way: &Way, slot: &str, stage: launch::StageConfig) -> Result<SwapReport, RemoteError> {
    swap_over(&way.open()?, vehicle, way, slot, stage)
}

/// The same over a link that there is.
pub(crate) fn swap_over(
    link: &Link,
    vehicle: &str,
    way: &Way,
    slot: &str,
    stage: launch::StageConfig,
) -> Result<SwapReport, RemoteError> {
    let Services { t_now_ns, services } = asked(link, vehicle)?;
    let status = services.into_iter().find(|one| one.service == slot);
    // A slot that is not there has no decision; the answer says so.
    let expected_epoch = status.map_or(1, |one| one.epoch).max(1);
    let request = SwapRequest {
        request_id: request_id(),
        slot: slot.into(),
        stage: stage.stage,
        set: stage.set,
        expected_epoch,
        t_deadline_ns: t_now_ns + SWAP_LIMIT.as_nanos() as u64,
    };
    let asked = Instant::now();
    let answer: Result<SwapAnswer, _> =
        link.query_one(&keys::key(vehicle, keys::SWAP), request.to_bytes(), SWAP_LIMIT + ANSWER_LIMIT);
    match answer {
        Ok(answer) => Ok(report(answer)),
        // Who has just answered has not gone: an access list ends such a question at once.
        Err(LinkError::NoResponse { .. }) if asked.elapsed() < SWAP_LIMIT => Err(way.no_command(vehicle, &request)),
        Err(error) => Err(error.into()),
    }
}

fn asked(link: &Link, vehicle: &str) -> Result<Services, LinkError> {
    link.query_one(&keys::key(vehicle, keys::SERVICES), Vec::new(), ANSWER_LIMIT)
}

/// Another for every request: this process and the time.
fn request_id() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    format!("{}-{:x}", std::process::id(), since.as_nanos())
}

fn status(of: v1::ServiceStatus) -> ServiceStatus {
    let v1::ServiceStatus { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, at, troubles } = of;
    let said = |text: String| Some(text).filter(|text| !text.is_empty());
    let pid = Some(pid).filter(|pid| *pid != 0);
    let trouble = |v1::Trouble { kind, found, remedy }| Diagnostic { kind, found, remedy };
    let troubles = troubles.into_iter().map(trouble).collect();
    ServiceStatus {
        service,
        stage: said(stage),
        state,
        pid,
        restarts,
        incarnation,
        epoch,
        ticks,
        lost,
        address: said(at),
        diagnostics: troubles,
    }
}

fn report(answer: SwapAnswer) -> SwapReport {
    let outcome = match answer.outcome() {
        swap_answer::Outcome::Committed => SwapOutcome::Committed,
        swap_answer::Outcome::Aborted => SwapOutcome::Aborted,
        // Of one that is not known by its deadline the reason says so.
        _ => SwapOutcome::Refused,
    };
    let SwapAnswer { reason, slot, from, to, commit_tick, lost, duplicated, gap_s, jump_rad, .. } = answer;
    SwapReport {
        slot,
        from,
        to,
        commit_tick,
        lost,
        duplicated,
        gap_us: gap_s * 1e6,
        jump_deg: jump_rad.to_degrees(),
        outcome,
        reason: Some(reason).filter(|reason| !reason.is_empty()),
    }
}
