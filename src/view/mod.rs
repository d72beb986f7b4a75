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
    board::{Board, SupervisorDesk},
    hub::Hub,
    recording::Recording,
    server::{self, Server, Site},
    sight::{Look, Sight},
    token::Token,
};
use control::{ControlRequest, ServiceStatus, ask};
use flight::reader;
use launch::{Cockpit, Service};

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
    /// Where to listen, an address of the loopback; the next free port if that is taken [default: 127.0.0.1:8088].
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    listen: Option<SocketAddr>,
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
    let token = Token::of_user()?;
    let statuses: Vec<ServiceStatus> = ask(&name, &ControlRequest::Ps).unwrap_or_default();
    let own = statuses.into_iter().find(|one| one.service == Service::Cockpit.name()).and_then(|one| one.at);
    if let Some(base) = own.filter(|_| view.listen.is_none()) {
        // The system shows itself.
        return Ok(print(&server::address(&base, Some(&token))));
    }
    let (hub, desk) = (Arc::new(Hub::default()), Arc::new(SupervisorDesk::new(&name)));
    let server = Server::bind(listen(view))?;
    let at = server.address(Some(&token));
    let look = Look { system: name.clone(), hub: hub.clone(), desk: Some(desk.clone()) };
    server.start(site(look, Some(token), None))?;
    let printed = print(&at);
    let mut until = Until::new(|| true, view.seconds);
    let mut source = Board::new(&name);
    let Ok(()) =
        cockpit::present(&mut source, desk, &hub, &mut |_| Ok::<_, std::convert::Infallible>(!until.is_over()));
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
    hub.tell(recording.standing());
    let server = Server::bind(listen(view))?;
    let at = server.address(None);
    let look = Look { system: name, hub, desk: None };
    server.start(site(look, None, Some(recording)))?;
    let printed = print(&at);
    wait(view);
    Ok(printed)
}

/// Vehicles elsewhere.
fn show_fleet(view: &View, vehicle: Option<&str>) -> Result<ExitCode, ViewError> {
    let token = Token::of_user()?;
    let link = view.way.open()?;
    let fleet = fleet::Fleet::over(link.clone(), &view.way, vehicle).map_err(RemoteError::from)?;
    let server = Server::bind(listen(view))?;
    let at = server.address(Some(&token));
    server.start(site(fleet, Some(token), None))?;
    let printed = print(&at);
    wait(view);
    link.close();
    Ok(printed)
}

fn site(sight: impl Sight + 'static, token: Option<Token>, recording: Option<Arc<Recording>>) -> Site {
    Site { sight: Arc::new(sight), token, recording, foxglove_origins: Vec::new() }
}

/// Until it is to end.
fn wait(view: &View) {
    let mut until = Until::new(|| true, view.seconds);
    while !until.is_over() {
        std::thread::sleep(LOOK);
    }
}

fn listen(view: &View) -> SocketAddr {
    view.listen.unwrap_or(Cockpit::default().listen)
}

fn address(text: &str) -> Result<SocketAddr, String> {
    Cockpit::address(text).ok_or_else(|| format!("expected {}", Cockpit::EXPECTED))
}
