//! `plumb view`: a system, a vehicle elsewhere or a recorded flight as a page in a browser.

mod elsewhere;
mod fleet;

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    process::ExitCode,
    sync::Arc,
    time::Duration,
};

use clap::Args;
use cockpit::{
    board::{LocalSystem, SupervisorClient},
    hub::Hub,
    recording::Recording,
    server::{self, Server, Site},
    sight::{Look, Sight},
    token::{Role, Token, Tokens},
};
use control::{ControlRequest, ServiceStatus, send_request};
use flight::reader;
use launch::{Cockpit, CockpitTls, Service};

use crate::{
    fail,
    out::print,
    remote::{RemoteError, Way},
    seeing::{Until, duration},
};

/// Between two looks whether it is to end.
const LOOK: Duration = Duration::from_millis(50);

/// The command line of `plumb view`.
#[derive(Args)]
pub(crate) struct View {
    /// A flight that was recorded (MCAP), in the place of a running system.
    #[arg(conflicts_with_all = ["name", "remote"])]
    file: Option<PathBuf>,
    /// The system's name [default: that of ./launch.toml, else plumbline].
    #[arg(long = "system", value_name = "NAME")]
    name: Option<String>,
    /// Vehicles elsewhere in the place of a system here, over the network; the page begins with this one, else with the list of all in sight.
    #[arg(long, value_name = "VEHICLE", num_args = 0..=1, conflicts_with = "name")]
    remote: Option<Option<String>>,
    #[command(flatten)]
    way: Way,
    /// Where to listen, beyond the loopback with --tls; the next free port if that is taken [default: 127.0.0.1:8088].
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    listen: Option<SocketAddr>,
    /// Serve by TLS, with the certificate of a folder that `plumb keys vehicle NAME --host HOST` has made; then looking needs a token, too.
    #[arg(long, value_name = "FOLDER")]
    tls: Option<PathBuf>,
    /// Print the address for somebody who may look and not command.
    #[arg(long)]
    viewer: bool,
    /// End after so long [default: Ctrl-C ends it].
    #[arg(long, value_parser = duration)]
    seconds: Option<Duration>,
}

/// Why nothing is shown.
#[derive(Debug, thiserror::Error)]
enum ViewError {
    #[error(transparent)]
    Server(#[from] server::ServerError),
    #[error(transparent)]
    Token(#[from] cockpit::token::TokenError),
    #[error(transparent)]
    Flight(#[from] flight::FlightError),
    #[error(
        "showing {path}: it is no flight; `plumb up --replay {path} --record flights` makes one of a recording, and shows it meanwhile"
    )]
    NoFlight { path: String },
    #[error("showing {path}: it has no samples")]
    Empty { path: String },
    #[error(transparent)]
    Remote(#[from] RemoteError),
    #[error(
        "listening at {listen}: beyond the loopback --tls is needed, with a folder that `plumb keys vehicle NAME --host HOST` makes; or `ssh -L 8088:127.0.0.1:8088 HOST` leads to the loopback"
    )]
    Open { listen: SocketAddr },
}

pub(crate) fn run(view: &View) -> ExitCode {
    let shown = match (&view.file, &view.remote) {
        (Some(file), _) => show_flight(view, file),
        (None, Some(vehicle)) => show_fleet(view, vehicle.as_deref()),
        (None, None) => show_system(view),
    };
    match shown {
        Ok(code) => code,
        Err(error) => {
            let code = match &error {
                ViewError::NoFlight { .. } => 3,
                ViewError::Open { .. } => 2,
                ViewError::Remote(error) => error.exit_code(),
                _ => 1,
            };
            fail(&error, code)
        }
    }
}

/// A system on this machine, whether it runs yet or not.
fn show_system(view: &View) -> Result<ExitCode, ViewError> {
    let name = crate::system::name(view.name.as_deref());
    let tokens = Tokens::of_user()?;
    let statuses: Vec<ServiceStatus> = send_request(&name, &ControlRequest::Status).unwrap_or_default();
    let own = statuses.into_iter().find(|one| one.service == Service::Cockpit.name()).and_then(|one| one.address);
    if let Some(base) = own.filter(|_| view.listen.is_none()) {
        // The system shows itself.
        return Ok(print(&server::address(&base, Some(view.token(&tokens)))));
    }
    let (hub, desk) = (Arc::new(Hub::default()), Arc::new(SupervisorClient::new(&name)));
    let server = view.bind()?;
    let at = server.address(Some(view.token(&tokens)));
    let look = Look { system: name.clone(), hub: hub.clone(), desk: Some(desk.clone()) };
    server.start(site(look, Some(tokens), None))?;
    let printed = print(&at);
    let mut until = Until::new(|| true, view.seconds);
    let mut source = LocalSystem::new(&name);
    let Ok(()) =
        cockpit::publish_source(&mut source, desk, &hub, &mut |_| Ok::<_, std::convert::Infallible>(!until.is_over()));
    Ok(printed)
}

/// A recorded flight.
fn show_flight(view: &View, path: &Path) -> Result<ExitCode, ViewError> {
    let shown = path.display().to_string();
    if path.is_file() && !flight::is_flight(path) {
        return Err(ViewError::NoFlight { path: shown });
    }
    let Some(span) = reader::span(path)? else { return Err(ViewError::Empty { path: shown }) };
    let seconds = (span.t_last_ns - span.t_first_ns) as f64 * 1e-9;
    let rate_hz = if seconds > 0.0 { (span.samples - 1) as f64 / seconds } else { 0.0 };
    let name = path.file_name().map_or(shown, |name| name.to_string_lossy().into_owned());
    let mut reading = Recording::reading(&name, rate_hz, span.t_first_ns, span.t_last_ns);
    reader::every_message(path, &mut |t_ns, topic, bytes| reading.take(t_ns, topic, bytes))?;
    let (hub, recording) = (Arc::new(Hub::default()), Arc::new(reading.finish()));
    hub.publish_status(recording.standing());
    let server = view.bind()?;
    // On the loopback whoever is on the machine may look at a recording, and there is nothing to command.
    let tokens = view.tls.is_some().then(Tokens::of_user).transpose()?;
    let at = server.address(tokens.as_ref().map(|tokens| view.token(tokens)));
    let look = Look { system: name, hub, desk: None };
    server.start(site(look, tokens, Some(recording)))?;
    let printed = print(&at);
    wait(view);
    Ok(printed)
}

/// Vehicles elsewhere.
fn show_fleet(view: &View, vehicle: Option<&str>) -> Result<ExitCode, ViewError> {
    let tokens = Tokens::of_user()?;
    let link = view.way.open()?;
    let fleet = fleet::Fleet::over(link.clone(), &view.way, vehicle).map_err(RemoteError::from)?;
    let server = view.bind()?;
    let at = server.address(Some(view.token(&tokens)));
    server.start(site(fleet, Some(tokens), None))?;
    let printed = print(&at);
    wait(view);
    link.close();
    Ok(printed)
}

fn site(sight: impl Sight + 'static, tokens: Option<Tokens>, recording: Option<Arc<Recording>>) -> Site {
    Site { sight: Arc::new(sight), tokens, recording, foxglove_origins: Vec::new() }
}

/// Until it is to end.
fn wait(view: &View) {
    let mut until = Until::new(|| true, view.seconds);
    while !until.is_over() {
        std::thread::sleep(LOOK);
    }
}

impl View {
    /// Where it listens.
    fn bind(&self) -> Result<Server, ViewError> {
        let listen = self.listen.unwrap_or(Cockpit::default().listen);
        if self.tls.is_none() && !listen.ip().is_loopback() {
            return Err(ViewError::Open { listen });
        }
        let file = |folder: &Path, name| folder.join(name);
        let tls = self.tls.as_deref();
        let tls = tls.map(|folder| CockpitTls { cert: file(folder, "cert.pem"), key: file(folder, "key.pem") });
        Ok(Server::bind(listen, tls.as_ref())?)
    }

    /// What stands in the address that is printed.
    fn token<'t>(&self, tokens: &'t Tokens) -> &'t Token {
        tokens.of(if self.viewer { Role::Viewer } else { Role::Operator })
    }
}

fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| "expected an address with a port, as 127.0.0.1:8088".into())
}
