//! The cockpit: a system as a page in a browser, live and afterwards.
//!
//! Input: the messages of a system or of a recording, and what its supervisor says. Output: a page over HTTP, pictures over a WebSocket,
//! commands to the supervisor. Time: a picture is made 30 times a second, of what came since the one before. Failure: a browser that is
//! slow skips pictures, one that hangs is dropped, a page that is not ours gets nothing; nobody on the data path waits for any of it.
//!
//! One thread looks at the system and makes pictures, one asks the supervisor once a second and after each event how it is, one serves.
//!
//! | module | what it holds |
//! | --- | --- |
//! | [`source`] | where the data come from, and who answers for the system |
//! | [`board`] | a system on this machine |
//! | [`recording`] | a recording, thinned out |
//! | [`picture`] | messages thinned to what is seen |
//! | [`calibration`] | how far the sensors' readings suffice for one |
//! | `standing` | how the system is, once a second and after each event |
//! | [`sight`] | what a page can look at |
//! | [`hub`] | between who makes pictures and who sends them |
//! | `metrics` | how the system is, as Prometheus reads it |
//! | [`server`] | connections and their limits |
//! | `foxglove` | the system for Foxglove and Lichtblick, where that is built in |
//! | `guard` | whom it answers, and what a browser may do with the answer |
//! | `assets` | the page |
//! | `socket` | a viewer |
//! | `commands` | what a viewer may ask for |
//! | [`token`] | who may look and who may command |
//! | [`tls`] | TLS, for whoever looks from another machine |
#![forbid(unsafe_code)]

mod assets;
pub mod board;
pub mod calibration;
mod commands;
#[cfg(feature = "foxglove")]
mod foxglove;
mod guard;
pub mod hub;
mod metrics;
pub mod picture;
pub mod recording;
pub mod server;
pub mod sight;
mod socket;
pub mod source;
mod standing;
pub mod tls;
pub mod token;

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
    board::LocalSystem,
    calibration::Calibration,
    hub::Hub,
    picture::Decimator,
    server::{Server, ServerError},
    sight::Look,
    source::{CommandTarget, Source, SourceState},
    standing::Watch,
    token::{Role, TokenError, Tokens},
};

/// Between two pictures.
pub const SNAPSHOT_INTERVAL: Duration = Duration::from_millis(33);
/// Between two standings.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);
/// How much more than the services of the path the cockpit lets others have the machine.
const NICENESS: i32 = 10;
/// How long the supervisor is sought for, to be told the address.
const SUPERVISOR_CONNECT_TIMEOUT: Duration = Duration::from_secs(30);

/// Why the cockpit ended.
#[derive(Debug, thiserror::Error)]
pub enum CockpitError {
    /// The system could not be joined.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The page cannot be served.
    #[error(transparent)]
    Server(#[from] ServerError),
    /// There is no token for commands.
    #[error(transparent)]
    Token(#[from] TokenError),
}

/// The service.
pub fn run() -> Result<(), CockpitError> {
    let mut context = ServiceContext::join(Service::Cockpit)?;
    // A machine that has too little for everybody has it for the data path. Where that cannot be had it is not needed.
    let _ = rustix::process::nice(NICENESS);
    let launch = context.config.launch.clone();
    let (hub, supervisor) = (Arc::new(Hub::default()), Arc::new(board::SupervisorClient::new(&launch.name)));
    let tokens = Tokens::of_user()?;
    let server = Server::bind(launch.cockpit.listen, launch.cockpit.tls.as_ref())?;
    let address = server.address(Some(tokens.of(Role::Operator)));
    let name = launch.name.clone();
    thread::spawn(move || report_address(&name, &address));
    let view = Look { system: launch.name.clone(), hub: hub.clone(), desk: Some(supervisor.clone()) };
    server.start(server::Site {
        sight: Arc::new(view),
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

/// Shows a source until `should_continue` says otherwise, which is asked before each picture and told how many there were.
pub fn publish_source<E>(
    source: &mut dyn Source,
    target: Arc<dyn CommandTarget>,
    hub: &Hub,
    should_continue: &mut dyn FnMut(u64) -> Result<bool, E>,
) -> Result<(), E> {
    let mut decimator = Decimator::default();
    let mut monitor = Watch::new(target, source.has_every_tick());
    #[cfg(feature = "foxglove")]
    let mut feed = foxglove::feed::Feed::new(hub.broadcaster.clone());
    let mut last_status = None::<Instant>;
    let mut calibration = None::<Calibration>;
    while should_continue(decimator.snapshots())? {
        let started = Instant::now();
        #[cfg(feature = "foxglove")]
        let now_ns = monotonic_ns();
        let state = source.look(&mut |topic, bytes| {
            decimator.take(topic, bytes);
            monitor.take(topic, bytes);
            calibration.iter_mut().for_each(|calibration| calibration.push(topic, bytes));
            #[cfg(feature = "foxglove")]
            feed.take(topic, bytes, now_ns);
        });
        #[cfg(feature = "foxglove")]
        feed.source_is(&state);
        if last_status.is_none_or(|told| told.elapsed() >= STATUS_INTERVAL) || monitor.is_another(&state) {
            last_status = Some(started);
            hub.publish_status(monitor.standing(state.clone()));
        }
        update_calibration(&mut calibration, source, hub, state == SourceState::Live);
        hub.publish_snapshot(decimator.picture(monotonic_ns()));
        thread::sleep(SNAPSHOT_INTERVAL.saturating_sub(started.elapsed()));
    }
    Ok(())
}

/// Begins and ends calibrations as they are asked for, and tells how the one under way does.
fn update_calibration(calibration: &mut Option<Calibration>, source: &mut dyn Source, hub: &Hub, is_live: bool) {
    if let Some(request) = hub.take_calibration_request() {
        source.set_readings_topic(request.as_ref().map(|wish| wish.topic));
        if request.is_none() {
            hub.publish_calibration(wire::v1::Calibration::default());
        }
        *calibration = request.map(Calibration::new);
    }
    let Some(active) = calibration else { return };
    let progress = active.progress();
    let is_aborted = !is_live || active.is_expired();
    if is_aborted || progress.as_ref().is_some_and(|news| !news.report.is_empty()) {
        source.set_readings_topic(None);
        *calibration = None;
    }
    if let Some(progress) = if is_aborted { Some(wire::v1::Calibration::default()) } else { progress } {
        hub.publish_calibration(progress);
    }
}

/// Tells the supervisor where the page is, once it answers.
fn report_address(system: &str, address: &str) {
    let request = ControlRequest::Address { service: Service::Cockpit.name().into(), address: address.into() };
    let deadline = Instant::now() + SUPERVISOR_CONNECT_TIMEOUT;
    while control::send_request::<()>(system, &request).is_err() && Instant::now() < deadline {
        thread::sleep(Duration::from_millis(100));
    }
}
