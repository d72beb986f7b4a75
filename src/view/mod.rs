//! `plumb view`: shows a system, remote vehicles or a recorded flight in a browser.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use clap::Args;
use cockpit::{
    hub::Hub,
    local_system::{LocalSystem, SupervisorClient},
    recording::Recording,
    server::{self, Server, SiteContent},
    token::{Role, Token, Tokens},
    vehicles::{VehicleDirectory, VehicleView},
};
use control::{ControlRequest, ServiceStatus, send_request};
use flight::reader;
use launch::{Cockpit, CockpitTls, Service};

use crate::{
    duration::duration,
    failure::{Failure, OrFail as _, Outcome},
    stdout::print,
    system::{EndpointArgs, SystemNameArgs},
    topics::StopCondition,
};

/// Interval between two checks of the stop condition.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Arguments of `plumb view`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  plumb view
  plumb view flights/alpha-20261123T050708Z.mcap
  plumb view --remote boat --connect quic/base:7447 --keys keys/operator.ann")]
pub(crate) struct View {
    /// Recorded flight (MCAP) instead of a running system
    #[arg(conflicts_with_all = ["system", "launch", "remote"])]
    file: Option<PathBuf>,
    #[command(flatten)]
    system: SystemNameArgs,
    /// Remote vehicle to open first [default: the list of all vehicles]
    #[arg(long, value_name = "VEHICLE", num_args = 0..=1, conflicts_with_all = ["system", "launch"])]
    remote: Option<Option<String>>,
    #[command(flatten)]
    endpoint: EndpointArgs,
    #[arg(long, value_name = "ADDRESS", value_parser = parse_address, help = listen_help())]
    listen: Option<SocketAddr>,
    /// Folder created by `plumb keys vehicle NAME --host HOST`, for TLS
    #[arg(long, value_name = "FOLDER")]
    tls: Option<PathBuf>,
    /// Print a read-only address, which cannot send commands
    #[arg(long)]
    viewer: bool,
    /// Time before stopping, such as 10s [default: until Ctrl-C]
    #[arg(long = "for", value_name = "TIME", value_parser = duration)]
    duration: Option<Duration>,
}

pub(crate) fn run(view: &View) -> Outcome {
    match (&view.file, &view.remote) {
        (Some(file), _) => show_flight(view, file),
        (None, Some(vehicle)) => show_vehicles(view, vehicle.as_deref()),
        (None, None) => show_system(view),
    }
}

/// Shows a system on this machine, which may start later.
fn show_system(view: &View) -> Outcome {
    let name = view.system.name()?;
    let statuses: Vec<ServiceStatus> = send_request(&name, &ControlRequest::Status).unwrap_or_default();
    let own_address =
        statuses.into_iter().find(|one| one.service == *Service::Cockpit.name()).and_then(|one| one.address);
    if let Some(base) = own_address.filter(|_| view.listen.is_none()) {
        // The system runs a cockpit itself, so only the address is printed.
        let tokens = Tokens::load(&name)?;
        return Ok(print(&server::address(&base.to_string(), Some(view.role_token(&tokens)))));
    }
    let tokens = Tokens::create()?;
    let (hub, target) = (Arc::new(Hub::default()), Arc::new(SupervisorClient::new(&name)));
    let server = view.bind()?;
    let url = server.address(Some(view.role_token(&tokens)));
    let vehicle_view = VehicleView { system: name.clone(), hub: hub.clone(), target: Some(target.clone()) };
    server.start(site(vehicle_view, Some(tokens), None))?;
    let printed = print(&url);
    let mut stop = StopCondition::new(|| true, view.duration);
    let mut source = LocalSystem::new(&name);
    let Ok(()) =
        cockpit::publish_source(&mut source, target, &hub, &mut |_| Ok::<_, std::convert::Infallible>(!stop.is_met()));
    Ok(printed)
}

/// Shows remote vehicles, beginning with `vehicle` if given.
#[cfg(feature = "network")]
fn show_vehicles(view: &View, vehicle: Option<&str>) -> Outcome {
    let tokens = Tokens::create()?;
    let endpoint = view.endpoint.endpoint();
    let link = endpoint.open()?;
    let directory = remote::RemoteDirectory::start(link.clone(), endpoint, vehicle)?;
    let server = view.bind()?;
    let url = server.address(Some(view.role_token(&tokens)));
    server.start(site(directory, Some(tokens), None))?;
    let printed = print(&url);
    wait_until_stopped(view);
    link.close();
    Ok(printed)
}

#[cfg(not(feature = "network"))]
fn show_vehicles(_: &View, _: Option<&str>) -> Outcome {
    Err(crate::remote::ERROR.into())
}

/// Shows a recorded flight.
fn show_flight(view: &View, path: &Path) -> Outcome {
    let path_text = foreign::path(path).to_string();
    if path.is_file() && !flight::is_flight(path) {
        return Err(Failure::new(
            format_args!(
                "{path_text} is not a flight; replay it with `plumb up --replay {path_text} --record flights`, which also shows and records it"
            ),
            3,
        ));
    }
    let empty = || Failure::new(format_args!("{path_text} contains no samples"), 1);
    let span = reader::read_span(path).or_fail(1)?.ok_or_else(empty)?;
    let seconds = span.t_last_ns.abs_diff(span.t_first_ns) as f64 * 1e-9;
    let rate_hz = if seconds > 0.0 { (span.samples - 1) as f64 / seconds } else { 0.0 };
    let name = path.file_name().map_or(path_text, |name| name.to_string_lossy().into_owned());
    let mut builder = Recording::builder(&name, rate_hz, span.t_first_ns, span.t_last_ns);
    reader::for_each_message(path, &mut |t_ns, topic, bytes| builder.push(t_ns, topic, bytes)).or_fail(1)?;
    let (hub, recording) = (Arc::new(Hub::default()), Arc::new(builder.finish()));
    hub.publish_status(recording.status());
    let server = view.bind()?;
    // On the loopback interface any local user may view a recording, which accepts no commands.
    let tokens = view.tls.is_some().then(Tokens::create).transpose()?;
    let url = server.address(tokens.as_ref().map(|tokens| view.role_token(tokens)));
    let vehicle_view = VehicleView { system: name, hub, target: None };
    server.start(site(vehicle_view, tokens, Some(recording)))?;
    let printed = print(&url);
    wait_until_stopped(view);
    Ok(printed)
}

fn site(
    directory: impl VehicleDirectory + 'static,
    tokens: Option<Tokens>,
    recording: Option<Arc<Recording>>,
) -> SiteContent {
    SiteContent { vehicles: Arc::new(directory), tokens, recording, foxglove_origins: Vec::new() }
}

/// Waits until the time limit is reached or a signal arrives.
fn wait_until_stopped(view: &View) {
    let mut stop = StopCondition::new(|| true, view.duration);
    while !stop.is_met() {
        std::thread::sleep(POLL_INTERVAL);
    }
}

impl View {
    /// Binds the server. TLS is required except on the loopback interface.
    fn bind(&self) -> Result<Server, Failure> {
        let listen = self.listen.unwrap_or(Cockpit::default().listen);
        if self.tls.is_none() && !listen.ip().is_loopback() {
            return Err(Failure::new(
                format_args!(
                    "cannot listen at {listen} without --tls, because other hosts could connect; use a folder created by `plumb keys vehicle NAME --host HOST`, or forward the port with {}",
                    Cockpit::forward_command()
                ),
                2,
            ));
        }
        let file = |folder: &Path, name| folder.join(name);
        let tls = self.tls.as_deref();
        let tls = tls.map(|folder| CockpitTls { cert: file(folder, "cert.pem"), key: file(folder, "key.pem") });
        Ok(Server::bind(listen, tls.as_ref())?)
    }

    /// Returns the token for the printed address.
    fn role_token<'t>(&self, tokens: &'t Tokens) -> &'t Token {
        tokens.get(if self.viewer { Role::Viewer } else { Role::Operator })
    }
}

fn listen_help() -> String {
    format!("Address to listen on, or its next free port [default: {}]", Cockpit::default().listen)
}

fn parse_address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| format!("expected an IP address with a port, as in {}", Cockpit::default().listen))
}
