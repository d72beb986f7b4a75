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
    board::Board,
    calibration::Calibration,
    hub::Hub,
    picture::Thinner,
    server::{Server, ServerError},
    sight::Look,
    source::{Desk, Source, SourceState},
    standing::Watch,
    token::{Role, TokenError, Tokens},
};

/// Between two pictures.
pub const PICTURE_INTERVAL: Duration = Duration::from_millis(33);
/// Between two standings.
const STANDING_INTERVAL: Duration = Duration::from_secs(1);
/// How much more than the services of the path the cockpit lets others have the machine.
const NICENESS: i32 = 10;
/// How long the supervisor is sought for, to be told the address.
const DOOR_LIMIT: Duration = Duration::from_secs(30);

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
    let (hub, desk) = (Arc::new(Hub::default()), Arc::new(board::SupervisorDesk::new(&launch.name)));
    let tokens = Tokens::of_user()?;
    let server = Server::bind(launch.cockpit.listen, launch.cockpit.tls.as_ref())?;
    let at = server.address(Some(tokens.of(Role::Operator)));
    let name = launch.name.clone();
    thread::spawn(move || tell_address(&name, &at));
    let look = Look { system: launch.name.clone(), hub: hub.clone(), desk: Some(desk.clone()) };
    server.start(server::Site {
        sight: Arc::new(look),
        tokens: Some(tokens),
        recording: None,
        foxglove_origins: launch.cockpit.foxglove_origins,
    })?;
    let mut source = Board::new(&launch.name);
    present(&mut source, desk, &hub, &mut |pictures| {
        if context.ends() {
            return Ok(false);
        }
        context.publish_health(State::RUNNING, |health| health.ticks = pictures)?;
        Ok::<_, RuntimeError>(true)
    })?;
    Ok(())
}

/// Shows a source until `goes_on` says otherwise, which is asked before each picture and told how many there were.
pub fn present<E>(
    source: &mut dyn Source,
    desk: Arc<dyn Desk>,
    hub: &Hub,
    goes_on: &mut dyn FnMut(u64) -> Result<bool, E>,
) -> Result<(), E> {
    let mut thinner = Thinner::default();
    let mut watch = Watch::new(desk, source.has_every_tick());
    #[cfg(feature = "foxglove")]
    let mut feed = foxglove::feed::Feed::new(hub.live.clone());
    let mut told = None::<Instant>;
    let mut calibration = None::<Calibration>;
    while goes_on(thinner.pictures())? {
        let began = Instant::now();
        #[cfg(feature = "foxglove")]
        let now_ns = monotonic_ns();
        let state = source.look(&mut |topic, bytes| {
            thinner.take(topic, bytes);
            watch.take(topic, bytes);
            calibration.iter_mut().for_each(|calibration| calibration.take(topic, bytes));
            #[cfg(feature = "foxglove")]
            feed.take(topic, bytes, now_ns);
        });
        #[cfg(feature = "foxglove")]
        feed.source_is(&state);
        if told.is_none_or(|told| told.elapsed() >= STANDING_INTERVAL) || watch.is_another(&state) {
            told = Some(began);
            hub.tell(watch.standing(state.clone()));
        }
        attend(&mut calibration, source, hub, state == SourceState::Live);
        hub.show(thinner.picture(monotonic_ns()));
        thread::sleep(PICTURE_INTERVAL.saturating_sub(began.elapsed()));
    }
    Ok(())
}

/// Begins and ends calibrations as they are asked for, and tells how the one under way does.
fn attend(calibration: &mut Option<Calibration>, source: &mut dyn Source, hub: &Hub, is_live: bool) {
    if let Some(wish) = hub.wished() {
        source.read(wish.as_ref().map(|wish| wish.topic));
        if wish.is_none() {
            hub.tell_calibration(wire::v1::Calibration::default());
        }
        *calibration = wish.map(Calibration::new);
    }
    let Some(under_way) = calibration else { return };
    let news = under_way.news();
    let is_given_up = !is_live || under_way.is_over();
    if is_given_up || news.as_ref().is_some_and(|news| !news.report.is_empty()) {
        source.read(None);
        *calibration = None;
    }
    if let Some(news) = if is_given_up { Some(wire::v1::Calibration::default()) } else { news } {
        hub.tell_calibration(news);
    }
}

/// Tells the supervisor where the page is, once it answers.
fn tell_address(system: &str, at: &str) {
    let news = ControlRequest::At { service: Service::Cockpit.name().into(), at: at.into() };
    let deadline = Instant::now() + DOOR_LIMIT;
    while control::ask::<()>(system, &news).is_err() && Instant::now() < deadline {
        thread::sleep(Duration::from_millis(100));
    }
}
