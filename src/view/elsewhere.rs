//! A vehicle elsewhere, for the cockpit: its messages and its services as they come through its gateway.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use cockpit::{
    board::TOPICS,
    source::{SystemDescription, CommandTarget, Source, SourceState},
};
use control::{ServiceStatus, SwapReport, SwapRequest};
use graph::Topic;
use launch::{Launch, Output, Service, StageConfig};
use link::Link;
use messages::AttitudeOutput;
use runtime::frames::attitude_from_frame;
use wire::v1::VehicleLine;

use crate::{
    remote::{self, Way},
    seeing::elsewhere::{Crossing, Vehicle},
};

/// Between two attempts to find a vehicle.
const TRY_INTERVAL: Duration = Duration::from_secs(1);

/// What a vehicle sends.
pub(super) struct Telemetry {
    name: String,
    link: Link,
    found: Option<Found>,
    tried: Option<Instant>,
    state: SourceState,
}

/// A vehicle that is there, and the topics that it sends.
type Found = (Vehicle, Vec<(Topic, Crossing)>);

impl Telemetry {
    /// That of a vehicle, which need not be there yet.
    pub(super) fn new(name: &str, link: Link) -> Self {
        let state = SourceState::Connecting(format!("the vehicle {name:?} is looked for"));
        Self { name: name.into(), link, found: None, tried: None, state }
    }

    /// Now and then: whether it is there.
    fn attend(&mut self) {
        if let Some((vehicle, _)) = &self.found {
            if vehicle.is_in_reach() {
                self.state = SourceState::Live;
            } else {
                self.state = SourceState::Connecting(vehicle.out_of_reach());
                self.found = None;
            }
            return;
        }
        if self.tried.is_some_and(|tried| tried.elapsed() < TRY_INTERVAL) {
            return;
        }
        match Vehicle::over(self.link.clone(), &self.name) {
            Ok(vehicle) => {
                // What it does not send is not shown.
                let crossing = |topic| Some((topic, vehicle.crossing(topic).ok()?));
                let crossings = TOPICS.into_iter().filter_map(crossing).collect();
                self.found = Some((vehicle, crossings));
                self.state = SourceState::Live;
            }
            Err(error) => self.state = SourceState::Connecting(error.to_string()),
        }
        self.tried = Some(Instant::now());
    }
}

impl Source for Telemetry {
    fn look(&mut self, take: &mut dyn FnMut(Topic, &[u8])) -> SourceState {
        self.attend();
        if let Some((_, crossings)) = &mut self.found {
            for (topic, crossing) in crossings {
                crossing.look(messages::layout(*topic).size, &mut |_, come| {
                    if let Some((bytes, said)) = come {
                        match attitude_of(*topic, bytes, said) {
                            Some(attitude) => take(*topic, bytemuck::bytes_of(&attitude)),
                            None => take(*topic, bytes),
                        }
                    }
                    true
                });
            }
        }
        self.state.clone()
    }

    fn has_every_tick(&self) -> bool {
        false
    }
}

/// An attitude in the system's own frame, where it came in another.
fn attitude_of(topic: Topic, bytes: &[u8], said: Option<Output>) -> Option<AttitudeOutput> {
    let Output { frame, .. } = said.filter(|_| topic == Topic::Attitude)?;
    Some(attitude_from_frame(frame, bytemuck::try_pod_read_unaligned(bytes).ok()?))
}

/// The vehicles in sight, once a second.
pub(super) type Lines = Arc<Mutex<Vec<VehicleLine>>>;

/// Who answers for a vehicle elsewhere.
pub(super) struct Gateway {
    pub(super) name: String,
    pub(super) link: Link,
    pub(super) way: Way,
    pub(super) lines: Lines,
}

impl CommandTarget for Gateway {
    fn description(&self) -> Result<SystemDescription, String> {
        let launch = Launch::default();
        let stages = |slot: Service| launch.stage_names(slot).into_iter().map(str::to_owned).collect();
        let slots = Service::SLOTS.into_iter().map(|slot| (slot.name().to_owned(), stages(slot)));
        Ok(SystemDescription {
            system: self.name.clone(),
            source: "over the network".into(),
            slots: slots.collect(),
            ..SystemDescription::default()
        })
    }

    fn services(&self) -> Result<Vec<ServiceStatus>, String> {
        remote::services(&self.link, &self.name).map_err(|error| error.to_string())
    }

    fn vehicles(&self) -> Vec<VehicleLine> {
        self.lines.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn takes_commands(&self) -> bool {
        self.way.is_secured()
    }

    fn swap(&self, request: SwapRequest) -> Result<SwapReport, String> {
        if request.shadow {
            return Err("a shadow computes where the vehicle is: ask on board for it".into());
        }
        let stage = StageConfig { stage: request.stage.stage, set: BTreeMap::new() };
        remote::swap_over(&self.link, &self.name, &self.way, &request.slot, stage).map_err(|error| error.to_string())
    }

    fn cancel_shadow(&self, _slot: &str) -> Result<(), String> {
        Err("a shadow is ended where the vehicle is: ask on board for it".into())
    }
}
