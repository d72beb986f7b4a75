//! The cockpit: a web page that shows a running system or a recording.
//!
//! Input: messages of a system or a recording, and the responses of its supervisor.
//! Output: a page over HTTP, snapshots over a WebSocket, commands to the supervisor.
//! Time: 30 snapshots per second, each covering the messages since the previous one.
//! Failure: a slow browser misses snapshots, a hung one is disconnected, and requests from foreign
//! pages are rejected. The data path never waits for the cockpit.
//!
//! One thread reads the system and publishes snapshots. A second one queries the supervisor once a
//! second and after each event. A third one serves the clients.
//!
//! | module | contents |
//! | --- | --- |
//! | [`source`] | interfaces to a system: its messages, its status and its commands |
//! | [`local_system`] | a system on this machine |
//! | `log` | log of the running system, for operators |
//! | [`recording`] | a recording, reduced to snapshots |
//! | `recorder` | recording of the running system, started by an operator |
//! | [`decimator`] | reduction of messages to what the page shows |
//! | [`calibration`] | calibration of the running system's sensors |
//! | `status` | status of the system, once a second and after each event |
//! | [`vehicles`] | selection of the vehicle that a page shows |
//! | [`hub`] | distribution of snapshots to the viewers |
//! | `metrics` | metrics in the text format of Prometheus |
//! | [`server`] | connections and their limits |
//! | `places` | limits on the number of clients, with and without a token |
//! | `inflow` | limits on what a client sends |
//! | `locked` | locking of mutexes, even after a panic |
//! | `foxglove` | WebSocket for Foxglove and Lichtblick, with the feature `foxglove` |
//! | `origin_check` | protection against requests from foreign pages |
//! | `authorization` | check of a client's token |
//! | `assets` | files of the page |
//! | `socket` | WebSocket of a viewer |
//! | `commands` | commands of viewers |
//! | [`token`] | tokens for viewing and for commands |
//! | [`tls`] | TLS for clients on other machines |
#![forbid(unsafe_code)]

mod assets;
mod authorization;
pub mod calibration;
mod commands;
pub mod decimator;
#[cfg(feature = "foxglove")]
mod foxglove;
pub mod hub;
mod inflow;
pub mod local_system;
mod locked;
mod log;
mod metrics;
mod origin_check;
mod places;
mod recorder;
pub mod recording;
pub mod server;
mod socket;
pub mod source;
mod status;
pub mod tls;
pub mod token;
pub mod vehicles;

use std::{
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use control::ControlRequest;
use graph::Service;
use messages::State;
use runtime::{RuntimeError, ServiceContext, clock::monotonic_ns};

use crate::{
    calibration::Calibration,
    decimator::{Decimator, SNAPSHOT_INTERVAL},
    hub::Hub,
    local_system::LocalSystem,
    server::{Server, ServerError},
    source::{CommandTarget, Source, SourceState},
    status::StatusMonitor,
    token::{Role, TokenError, Tokens},
    vehicles::VehicleView,
};

/// Interval between status messages.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);
/// Niceness of the cockpit, so that the services of the data path take precedence.
const NICENESS: i32 = 10;

/// Error that ends the cockpit.
#[derive(Debug, thiserror::Error)]
pub enum CockpitError {
    /// The cockpit cannot join the system, or publishing its health failed.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The page cannot be served.
    #[error(transparent)]
    Server(#[from] ServerError),
    /// No token for commands is available.
    #[error(transparent)]
    Token(#[from] TokenError),
}

/// Runs the cockpit as a service until the supervisor stops it.
///
/// # Errors
///
/// Returns an error if the cockpit cannot join the system, read its tokens or bind its port.
pub fn run() -> Result<(), CockpitError> {
    let mut context = ServiceContext::join(Service::Cockpit)?;
    // An overloaded machine must serve the data path first. If the priority cannot be lowered, the
    // cockpit runs at normal priority.
    let _ = rustix::process::nice(NICENESS);
    let launch = context.config.launch.clone();
    let (hub, supervisor) = (Arc::new(Hub::default()), Arc::new(local_system::SupervisorClient::new(&launch.name)));
    let tokens = Tokens::load_or_create(&launch.name, context.config.run_id())?;
    let server = Server::bind(launch.cockpit.listen, launch.cockpit.tls.as_ref())?;
    let address = server.address(Some(tokens.get(Role::Operator)));
    let name = launch.name.clone();
    thread::spawn(move || report_address(&name, &address));
    let view = VehicleView { system: launch.name.clone(), hub: hub.clone(), target: Some(supervisor.clone()) };
    server.start(server::SiteContent {
        vehicles: Arc::new(view),
        tokens: Some(tokens),
        recording: None,
        foxglove_origins: launch.cockpit.foxglove_origins,
    })?;
    let mut source = LocalSystem::new(&launch.name);
    publish_source(&mut source, supervisor, &hub, &mut |snapshots| {
        if context.should_stop() {
            return Ok(false);
        }
        context.publish_health(State::RUNNING, |health| health.ticks = snapshots)?;
        Ok::<_, RuntimeError>(true)
    })?;
    Ok(())
}

/// Publishes the snapshots and the status of a source until `should_continue` returns `false`.
///
/// `should_continue` is called before each snapshot with the number of snapshots published so far.
///
/// # Errors
///
/// Returns the error of `should_continue`.
pub fn publish_source<E>(
    source: &mut dyn Source,
    target: Arc<dyn CommandTarget>,
    hub: &Hub,
    should_continue: &mut dyn FnMut(u64) -> Result<bool, E>,
) -> Result<(), E> {
    let mut decimator = Decimator::default();
    let mut monitor = StatusMonitor::new(target.clone(), source.has_every_tick());
    #[cfg(feature = "foxglove")]
    let mut feed = foxglove::feed::Feed::new(hub.broadcaster.clone());
    let mut last_status = None::<Instant>;
    let mut calibration = None::<Calibration>;
    while should_continue(decimator.snapshots())? {
        let started = Instant::now();
        #[cfg(feature = "foxglove")]
        let now_ns = monotonic_ns();
        let state = source.poll(&mut |topic, bytes| {
            decimator.push(topic, bytes);
            monitor.push(topic, bytes);
            calibration.iter_mut().for_each(|calibration| calibration.push(topic, bytes));
            #[cfg(feature = "foxglove")]
            feed.push(topic, bytes, now_ns);
        });
        #[cfg(feature = "foxglove")]
        feed.set_source_state(&state);
        if last_status.is_none_or(|last| last.elapsed() >= STATUS_INTERVAL) || monitor.has_changed(&state) {
            last_status = Some(started);
            hub.publish_status(monitor.status(state.clone()));
        }
        update_calibration(&mut calibration, source, hub, state == SourceState::Live);
        hub.publish_snapshot(decimator.take_snapshot(monotonic_ns()));
        thread::sleep(SNAPSHOT_INTERVAL.saturating_sub(started.elapsed()));
    }
    // Completes the file of a recording. An error means that nothing is being recorded.
    let _ = target.stop_recording();
    Ok(())
}

/// Starts and cancels calibrations on request, and publishes the progress of the active one.
fn update_calibration(calibration: &mut Option<Calibration>, source: &mut dyn Source, hub: &Hub, is_live: bool) {
    if let Some(request) = hub.take_calibration_request() {
        source.set_readings_topic(request.as_ref().map(|request| request.topic.topic()));
        if request.is_none() {
            hub.publish_calibration(wire::v1::Calibration::default(), None);
        }
        *calibration = request.map(Calibration::new);
    }
    let Some(active) = calibration else { return };
    let progress = active.progress();
    let is_aborted = !is_live || active.is_expired();
    if is_aborted || progress.as_ref().is_some_and(|(_, sections)| sections.is_some()) {
        source.set_readings_topic(None);
        *calibration = None;
    }
    if let Some((progress, sections)) = if is_aborted { Some(Default::default()) } else { progress } {
        hub.publish_calibration(progress, sections);
    }
}

/// Reports the address of the page to the supervisor, retrying until it responds.
fn report_address(system: &str, address: &str) {
    let request = ControlRequest::Address { service: Service::Cockpit.name().into(), address: address.into() };
    control::notify(system, &request, || false);
}
