//! Source and command target of the cockpit for a remote vehicle, through its gateway.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use cockpit::{
    local_system::observed_topics,
    source::{CommandTarget, SlotDescription, Source, SourceState, SystemDescription},
};
use control::{ServiceStatus, SwapReport, SwapRequest};
use graph::Topic;
use launch::{Launch, Output, Slot};
use link::Link;
use messages::AttitudeOutput;
use runtime::frames::attitude_from_frame;
use wire::v1::VehicleLine;

use crate::{
    endpoint::RemoteEndpoint,
    requests,
    vehicle::{RemoteTopic, RemoteVehicle},
};

/// Interval between two attempts to find a vehicle.
const TRY_INTERVAL: Duration = Duration::from_secs(1);

/// Topics of a remote vehicle as a source of the cockpit.
pub(crate) struct RemoteSource {
    /// Name of the vehicle; `None` while none is selected.
    name: Option<String>,
    link: Link,
    found: Option<Found>,
    tried_at: Option<Instant>,
    state: SourceState,
}

/// Vehicle, with the topics that are subscribed to.
type Found = (RemoteVehicle, Vec<(Topic, RemoteTopic)>);

impl RemoteSource {
    /// Creates the source for a vehicle, which may not be reachable yet.
    pub(crate) fn new(name: Option<&str>, link: Link) -> Self {
        let connecting = |name| SourceState::Connecting(format!("connecting to vehicle {name:?}"));
        let state = name.map_or(SourceState::Unselected, connecting);
        Self { name: name.map(str::to_owned), link, found: None, tried_at: None, state }
    }

    /// Checks whether the vehicle is reachable and connects if necessary.
    fn update_connection(&mut self) {
        if let Some((vehicle, _)) = &self.found {
            if vehicle.is_reachable() {
                self.state = SourceState::Live;
            } else {
                self.state = SourceState::Connecting(vehicle.unreachable_message());
                self.found = None;
            }
            return;
        }
        let Some(name) = &self.name else { return };
        if self.tried_at.is_some_and(|tried_at| tried_at.elapsed() < TRY_INTERVAL) {
            return;
        }
        match RemoteVehicle::find(self.link.clone(), name) {
            Ok(vehicle) => {
                // Topics that the vehicle does not publish are not shown.
                let remote_topic = |topic| Some((topic, vehicle.subscribe(topic).ok()?));
                let remote_topics = observed_topics().filter_map(remote_topic).collect();
                self.found = Some((vehicle, remote_topics));
                self.state = SourceState::Live;
            }
            Err(error) => self.state = SourceState::Connecting(error.to_string()),
        }
        self.tried_at = Some(Instant::now());
    }
}

impl Source for RemoteSource {
    fn poll(&mut self, take: &mut dyn FnMut(Topic, &[u8])) -> SourceState {
        self.update_connection();
        if let Some((_, remote_topics)) = &mut self.found {
            for (topic, remote_topic) in remote_topics {
                remote_topic.poll(messages::layout(*topic).size, &mut |_, message| {
                    if let Some((bytes, reported)) = message {
                        match to_native_frame(*topic, bytes, reported) {
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

/// Converts an attitude to the native frame. Returns `None` if the message is not an attitude or
/// has no reported frame.
fn to_native_frame(topic: Topic, bytes: &[u8], reported: Option<Output>) -> Option<AttitudeOutput> {
    let Output { frame, .. } = reported.filter(|_| topic == Topic::Attitude)?;
    Some(attitude_from_frame(frame, bytemuck::try_pod_read_unaligned(bytes).ok()?))
}

/// Summaries of all reachable vehicles, updated once a second.
pub(crate) type VehicleLines = Arc<Mutex<Vec<VehicleLine>>>;

/// Command target that lists the reachable vehicles and sends requests to the selected one.
pub(crate) struct RemoteCommandTarget {
    /// Name of the vehicle; `None` while none is selected.
    pub(crate) name: Option<String>,
    pub(crate) link: Link,
    pub(crate) endpoint: RemoteEndpoint,
    pub(crate) lines: VehicleLines,
}

impl CommandTarget for RemoteCommandTarget {
    fn description(&self) -> Result<SystemDescription, String> {
        let Some(name) = &self.name else { return Ok(SystemDescription::default()) };
        let launch = Launch::default();
        let stages = |slot: Slot| launch.stage_names(slot).into_iter().map(str::to_owned).collect();
        let slots = Slot::ALL.into_iter().map(|slot| SlotDescription {
            slot: slot.name().into(),
            stages: stages(slot),
            set: None,
        });
        Ok(SystemDescription {
            system: name.clone(),
            source: "over the network".into(),
            slots: slots.collect(),
            ..SystemDescription::default()
        })
    }

    fn services(&self) -> Result<Vec<ServiceStatus>, String> {
        let Some(name) = &self.name else { return Ok(Vec::new()) };
        requests::services(&self.link, name).map_err(|error| error.to_string())
    }

    fn vehicles(&self) -> Vec<VehicleLine> {
        self.lines.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn accepts_commands(&self) -> bool {
        self.name.is_some() && self.endpoint.is_secured()
    }

    fn swap(&self, request: SwapRequest) -> Result<SwapReport, String> {
        let name = self.name.as_deref().ok_or("no vehicle is selected")?;
        if request.shadow {
            return Err("a shadow cannot be started remotely; run `plumb shadow` on the vehicle".into());
        }
        requests::swap(&self.link, &self.endpoint, name, &request.slot, request.stage)
            .map_err(|error| error.to_string())
    }

    fn cancel_shadow(&self, _slot: &str) -> Result<(), String> {
        Err("a shadow cannot be ended remotely; end it on the vehicle".into())
    }
}
