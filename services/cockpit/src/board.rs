//! A system on this machine: its bus through an observer, its supervisor through the control socket.

use std::time::{Duration, Instant};

use bus::{Observer, SystemName, Tap};
use calibrate::{Kind, Known};
use control::{ControlRequest, ServiceStatus, SwapReport, SwapRequest, ask};
use graph::{Service, Topic};
use launch::{Launch, Source as LaunchSource};
use observe::readings;
use runtime::ServiceConfig;

use crate::{
    calibration::Wish,
    source::{Description, Desk, Source, SourceState},
};

/// What is looked at; of the path, an output before what it was made of.
pub const TOPICS: [Topic; 11] = [
    Topic::Attitude,
    Topic::Fused,
    Topic::Accel,
    Topic::Gyro,
    Topic::Mag,
    Topic::Imu,
    Topic::Gnss,
    Topic::Reference,
    Topic::Difference,
    Topic::Health,
    Topic::Event,
];
/// Between two attempts to find a system, or topics that are not yet there.
const TRY_INTERVAL: Duration = Duration::from_millis(300);

/// The bus of a system.
#[derive(Debug)]
pub struct Board {
    system: String,
    seat: Option<Seat>,
    tried: Option<Instant>,
    state: SourceState,
    /// Looked at beside [`TOPICS`].
    more: Option<Topic>,
}

#[derive(Debug)]
struct Seat {
    taps: Vec<(Topic, Tap)>,
    missing: Vec<Topic>,
    observer: Observer,
}

impl Board {
    /// The system of that name, which need not run yet.
    pub fn new(system: &str) -> Self {
        let state = SourceState::Connecting(format!("the system {system:?} does not run; `plumb up` starts it"));
        Self { system: system.into(), seat: None, tried: None, state, more: None }
    }

    /// Now and then: whether the run is still the same, and topics that have come.
    fn attend(&mut self) {
        if self.tried.is_some_and(|tried| tried.elapsed() < TRY_INTERVAL) {
            return;
        }
        self.tried = Some(Instant::now());
        if self.seat.as_ref().is_some_and(|seat| !seat.observer.is_running()) {
            self.seat = None;
            let why = format!("the system {:?} has ended; `plumb up` starts it again", self.system);
            self.state = SourceState::Ended(why);
            return;
        }
        if self.seat.is_none() {
            match SystemName::new(&self.system).and_then(|name| Observer::sit(&name, "cockpit")) {
                Ok(observer) => {
                    let missing = TOPICS.into_iter().chain(self.more).collect();
                    self.seat = Some(Seat { taps: Vec::new(), missing, observer });
                }
                Err(error) => {
                    // One that has ended is still told so.
                    if self.state == SourceState::Live {
                        self.state = SourceState::Connecting(error.to_string());
                    }
                    return;
                }
            }
        }
        if let Some(Seat { taps, missing, observer }) = &mut self.seat {
            missing.retain(|topic| match observer.tap(*topic) {
                Ok(tap) => {
                    taps.push((*topic, tap));
                    false
                }
                Err(_) => true,
            });
            taps.sort_by_key(|(topic, _)| TOPICS.iter().position(|one| one == topic));
            self.state = SourceState::Live;
        }
    }
}

impl Source for Board {
    fn look(&mut self, take: &mut dyn FnMut(Topic, &[u8])) -> SourceState {
        self.attend();
        let Some(seat) = &self.seat else { return self.state.clone() };
        let failed = seat.taps.iter().find_map(|(topic, tap)| tap.drain(&mut |bytes| take(*topic, bytes)).err());
        if let Some(error) = failed {
            self.seat = None;
            self.state = SourceState::Connecting(error.to_string());
        }
        self.state.clone()
    }

    fn has_every_tick(&self) -> bool {
        true
    }

    fn read(&mut self, topic: Option<Topic>) {
        self.more = topic;
        if let Some(Seat { taps, missing, .. }) = &mut self.seat {
            taps.retain(|(tapped, _)| TOPICS.contains(tapped));
            missing.retain(|missing| TOPICS.contains(missing));
            missing.extend(topic);
        }
    }
}

/// The supervisor of a system.
#[derive(Debug)]
pub struct SupervisorDesk {
    system: String,
}

impl SupervisorDesk {
    /// That of the system of this name.
    pub fn new(system: &str) -> Self {
        Self { system: system.into() }
    }

    fn ask<A: serde::de::DeserializeOwned>(&self, request: &ControlRequest) -> Result<A, String> {
        ask(&self.system, request).map_err(|error| error.to_string())
    }
}

impl Desk for SupervisorDesk {
    fn description(&self) -> Result<Description, String> {
        let ServiceConfig { launch, rate_hz, supervisor_pid, .. } = self.ask(&ControlRequest::ServiceConfig)?;
        let slots = Service::SLOTS.into_iter().filter(|slot| launch.services.contains(slot));
        let slots =
            slots.map(|slot| (slot.name().to_owned(), launch.stages_of(slot).into_iter().map(str::to_owned).collect()));
        Ok(Description {
            system: launch.name.clone(),
            source: source(&launch),
            rate_hz,
            slots: slots.collect(),
            supervisor_pid: Some(supervisor_pid),
        })
    }

    fn services(&self) -> Result<Vec<ServiceStatus>, String> {
        self.ask(&ControlRequest::Ps)
    }

    fn takes_commands(&self) -> bool {
        true
    }

    fn swap(&self, request: SwapRequest) -> Result<SwapReport, String> {
        self.ask(&ControlRequest::Swap(request))
    }

    fn cancel(&self, slot: &str) -> Result<(), String> {
        self.ask(&ControlRequest::Cancel { slot: slot.into() })
    }

    fn wish(&self, kind: Kind) -> Result<Wish, String> {
        let config: ServiceConfig = self.ask(&ControlRequest::ServiceConfig)?;
        let topic = readings::topic(&config).map_err(|error| error.to_string())?;
        let mut known = Known::default();
        readings::build_on_system(&mut known, &config).map_err(|error| error.to_string())?;
        Ok(Wish { kind, known, topic })
    }
}

/// What the system is fed with, for people.
fn source(launch: &Launch) -> String {
    let ingest = &launch.ingest;
    let at =
        |kind: &str, port: Option<&launch::Port>| port.map_or_else(|| kind.into(), |port| format!("{kind} {port}"));
    match ingest.source {
        LaunchSource::Sim => format!("sim {}", ingest.sim.scenario),
        LaunchSource::Replay => {
            let name = ingest.replay.file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into());
            format!("replay {name}")
        }
        LaunchSource::Bus => "bus".into(),
        LaunchSource::Stdin => "stdin".into(),
        LaunchSource::Udp => at("udp", ingest.live.udp.port.as_ref()),
        LaunchSource::Tcp => at("tcp", ingest.live.tcp.port.as_ref()),
        LaunchSource::Serial => at("serial", ingest.live.serial.port.as_ref()),
        LaunchSource::Mavlink => at("mavlink", ingest.live.mavlink.port.as_ref()),
        LaunchSource::Iio => format!("iio {}", ingest.live.iio.device),
    }
}
