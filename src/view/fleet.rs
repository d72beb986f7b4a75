//! Every vehicle in sight, for the cockpit: a line of each, and a look at those that somebody has chosen.

use std::{
    collections::BTreeMap,
    convert::Infallible,
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};

use cockpit::{
    hub::Hub,
    sight::{Look, Sight},
    source::{SystemDescription, CommandTarget, Source, SourceState},
};
use control::{ServiceStatus, SwapReport, SwapRequest};
use graph::Topic;
use link::{Link, LinkError, MessageStream};
use runtime::frames::attitude_from_frame;
use wire::{
    Payload as _,
    command::ControlMessage as _,
    keys,
    v1::{Services, VehicleLine},
};

use super::elsewhere::{Gateway, Lines, Telemetry};
use crate::{
    remote::Way,
    station::fleet::{self, Vehicle, Vehicles},
};

/// Between two lists of lines.
const LINES_INTERVAL: Duration = Duration::from_secs(1);
/// Between two questions to all vehicles how their services are, and the longest wait for answers.
const ASK_INTERVAL: Duration = Duration::from_secs(3);
const ASK_LIMIT: Duration = Duration::from_secs(2);
/// Longest wait for a message.
const TURN: Duration = Duration::from_millis(20);
/// Vehicles that are looked at at once.
const MAX_LOOKS: usize = 8;
/// A vehicle at which nobody has looked for so long is looked at no more; Prometheus asks once a minute.
const UNWATCHED_LIMIT: Duration = Duration::from_secs(90);

/// The vehicles that are reached over a link.
pub(super) struct Fleet {
    link: Link,
    way: Way,
    /// The one that is shown where none is named.
    first: Option<String>,
    lines: Lines,
    looks: Arc<Mutex<BTreeMap<String, Looked>>>,
}

/// A vehicle that is looked at.
struct Looked {
    look: Look,
    /// When somebody last was.
    watched: Instant,
}

impl Fleet {
    /// Begins to look around.
    pub(super) fn over(link: Link, way: &Way, first: Option<&str>) -> Result<Self, LinkError> {
        let lines = Lines::default();
        let messages = [Topic::Attitude.name(), keys::GATEWAY].map(|topic| link.subscribe(&keys::key("*", topic)));
        let signs = link.subscribe_liveliness(&keys::key("*", &format!("{}/**", keys::LIVELINESS)))?;
        let [attitudes, reports] = messages;
        let (streams, told, asking) = ([attitudes?, reports?], lines.clone(), link.clone());
        let services = Arc::new(Mutex::new(BTreeMap::new()));
        let answers = services.clone();
        thread::spawn(move || ask_all(&asking, &answers));
        thread::spawn(move || look_around(&streams, &signs, &services, &told));
        Ok(Self { link, way: way.clone(), first: first.map(str::to_owned), lines, looks: Arc::default() })
    }

    fn desk(&self, name: &str) -> Arc<dyn CommandTarget> {
        let (name, link, way, lines) = (name.to_owned(), self.link.clone(), self.way.clone(), self.lines.clone());
        Arc::new(Gateway { name, link, way, lines })
    }

    /// Begins to look at a vehicle, or at none.
    fn begin(&self, name: Option<&str>) -> Look {
        let hub = Arc::new(Hub::default());
        let desk: Arc<dyn CommandTarget> = match name {
            Some(name) => self.desk(name),
            None => Arc::new(Nobody(self.lines.clone())),
        };
        let system = name.unwrap_or_default().to_owned();
        let look = Look { system, hub: hub.clone(), desk: Some(desk.clone()) };
        let mut source: Box<dyn Source + Send> = match name {
            Some(name) => Box::new(Telemetry::new(name, self.link.clone())),
            None => Box::new(NoVehicle),
        };
        let (looks, name) = (self.looks.clone(), name.unwrap_or_default().to_owned());
        thread::spawn(move || {
            let shown = hub.clone();
            let Ok(()) = cockpit::publish_source(&mut *source, desk, &shown, &mut |_| {
                Ok::<_, Infallible>(is_watched(&looks, &name, &hub))
            });
        });
        look
    }
}

/// Somebody looks at it, or has not long ceased; else it is forgotten.
fn is_watched(looks: &Mutex<BTreeMap<String, Looked>>, name: &str, hub: &Hub) -> bool {
    let mut looks = looks.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(looked) = looks.get_mut(name) else { return true };
    if hub.has_viewers() {
        looked.watched = Instant::now();
    }
    let goes_on = looked.watched.elapsed() < UNWATCHED_LIMIT;
    if !goes_on {
        looks.remove(name);
    }
    goes_on
}

impl Sight for Fleet {
    fn look(&self, vehicle: Option<&str>) -> Result<Look, String> {
        let name = vehicle.or(self.first.as_deref());
        if let Some(name) = name.filter(|name| !keys::is_vehicle_name(name)) {
            return Err(format!("{name:?} is no name of a vehicle"));
        }
        let key = name.unwrap_or_default();
        let mut looks = self.looks.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(looked) = looks.get_mut(key) {
            looked.watched = Instant::now();
            return Ok(looked.look.clone());
        }
        // Whoever asks for names that nobody has takes no room from those who look.
        let in_sight = |name: &str| {
            self.lines.lock().unwrap_or_else(PoisonError::into_inner).iter().any(|line| line.vehicle == name)
        };
        if let Some(name) = vehicle.filter(|name| self.first.as_deref() != Some(*name) && !in_sight(name)) {
            return Err(format!("no vehicle {name} is in sight"));
        }
        if looks.len() >= MAX_LOOKS {
            return Err(format!("{MAX_LOOKS} vehicles are looked at already; close a page"));
        }
        let look = self.begin(name);
        looks.insert(key.into(), Looked { look: look.clone(), watched: Instant::now() });
        Ok(look)
    }
}

/// What the services of each vehicle said last.
type Answers = Mutex<BTreeMap<String, Services>>;

/// Asks all vehicles, for as long as somebody wants to know.
fn ask_all(link: &Link, answers: &Arc<Answers>) {
    while Arc::strong_count(answers) > 1 {
        let asked = Instant::now();
        // Who does not answer has no stage in its line.
        let come = link.query(&keys::key("*", keys::SERVICES), Vec::new(), ASK_LIMIT).unwrap_or_default();
        let come = come.iter().filter_map(|(key, bytes)| {
            let (name, _) = keys::parse(key)?;
            Some((name.to_owned(), Services::from_bytes(bytes).ok()?))
        });
        *answers.lock().unwrap_or_else(PoisonError::into_inner) = come.collect();
        thread::sleep(ASK_INTERVAL.saturating_sub(asked.elapsed()));
    }
}

/// Keeps the lines of all vehicles, for as long as somebody wants to see them.
fn look_around(streams: &[MessageStream; 2], signs: &MessageStream, services: &Answers, told: &Lines) {
    let (mut vehicles, mut before) = (Vehicles::new(), Instant::now());
    while Arc::strong_count(told) > 1 {
        while let Some(sign) = signs.next(Duration::ZERO) {
            fleet::see(&mut vehicles, &sign);
        }
        for stream in streams {
            if let Some(message) = stream.next(TURN) {
                // Without tables nothing can fail.
                let _ = fleet::take(&mut vehicles, &message, None);
            }
        }
        if before.elapsed() >= LINES_INTERVAL {
            before = Instant::now();
            let answers = services.lock().unwrap_or_else(PoisonError::into_inner).clone();
            let lines = vehicles.iter_mut().map(|(name, vehicle)| line(name, vehicle, answers.get(name)));
            *told.lock().unwrap_or_else(PoisonError::into_inner) = lines.collect();
        }
    }
}

fn line(name: &str, vehicle: &mut Vehicle, services: Option<&Services>) -> VehicleLine {
    let said = |slot: &str| services.and_then(|all| all.services.iter().find(|one| one.service == slot));
    VehicleLine {
        vehicle: name.into(),
        lives: vehicle.lives,
        age_s: vehicle.attitude_at.map(|at| at.elapsed().as_secs_f64()),
        attitude: vehicle.attitude.map(|attitude| attitude_from_frame(vehicle.frame, attitude).to_proto()),
        lost_messages: vehicle.lost(),
        lost_ticks: said("course").map(|status| status.lost),
        stage: said("fuser").map(|status| status.stage.clone()).unwrap_or_default(),
        services: vehicle.services.iter().cloned().collect(),
    }
}

/// Where no vehicle is chosen.
struct NoVehicle;

impl Source for NoVehicle {
    fn look(&mut self, _take: &mut dyn FnMut(Topic, &[u8])) -> SourceState {
        SourceState::Unselected
    }

    fn has_every_tick(&self) -> bool {
        false
    }
}

/// Who answers where no vehicle is chosen: only who is in sight is known.
struct Nobody(Lines);

impl CommandTarget for Nobody {
    fn description(&self) -> Result<SystemDescription, String> {
        Ok(SystemDescription::default())
    }

    fn services(&self) -> Result<Vec<ServiceStatus>, String> {
        Ok(Vec::new())
    }

    fn vehicles(&self) -> Vec<VehicleLine> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn takes_commands(&self) -> bool {
        false
    }

    fn swap(&self, _request: SwapRequest) -> Result<SwapReport, String> {
        Err("no vehicle is chosen".into())
    }

    fn cancel_shadow(&self, _slot: &str) -> Result<(), String> {
        Err("no vehicle is chosen".into())
    }
}
