//! A system on this machine, read through a bus observer and controlled through the supervisor's
//! control socket.

use std::{
    cmp::Reverse,
    time::{Duration, Instant},
};

use bus::{Observer, SystemName, Tap};
use calibrate::{Kind, Prior};
use control::{ControlRequest, ServiceStatus, SwapReport, SwapRequest, send_request};
use graph::Topic;
use launch::{Launch, Service, Slot, Source as LaunchSource};
use observe::readings;
use runtime::ServiceConfig;
use wire::v1::Recording;

use crate::{
    calibration::CalibrationRequest,
    log,
    recorder::FlightRecorder,
    source::{CommandTarget, SlotDescription, Source, SourceState, SystemDescription},
};

/// Interval between attempts to attach to a system or to topics that do not exist yet.
const RETRY_INTERVAL: Duration = Duration::from_millis(300);

/// Returns the topics to observe, in reverse order of the data path. The output of each slot
/// therefore comes before its inputs.
pub fn observed_topics() -> impl Iterator<Item = Topic> {
    Topic::ALL.iter().copied().rev().filter(|topic| is_observed(*topic))
}

/// Returns `true` for a topic that is shown. Topics with unchecked readings and topics for
/// exchanges between services are not shown.
fn is_observed(topic: Topic) -> bool {
    match topic {
        Topic::Imu | Topic::Mag | Topic::Gnss | Topic::Reference => true,
        Topic::Gyro | Topic::Accel | Topic::Fused | Topic::Attitude => true,
        Topic::Difference | Topic::Health | Topic::Event => true,
        Topic::Sensor | Topic::Receiver | Topic::Reading => false,
        Topic::Credit | Topic::Checkpoint | Topic::Control => false,
    }
}

/// Source that reads the bus of a system on this machine.
#[derive(Debug)]
pub struct LocalSystem {
    system: String,
    attachment: Option<Attachment>,
    last_attempt: Option<Instant>,
    state: SourceState,
    /// Topic to read in addition to the observed ones.
    extra_topic: Option<Topic>,
}

#[derive(Debug)]
struct Attachment {
    taps: Vec<(Topic, Tap)>,
    missing: Vec<Topic>,
    observer: Observer,
}

impl LocalSystem {
    /// Creates the source for the named system, which need not be running.
    pub fn new(system: &str) -> Self {
        let state = SourceState::Connecting(format!("system {system:?} is not running; start it with `plumb up`"));
        Self { system: system.into(), attachment: None, last_attempt: None, state, extra_topic: None }
    }

    /// Attaches to the system and to topics that have become available, at most once per
    /// [`RETRY_INTERVAL`]. Also detects the end of the system.
    fn update_connection(&mut self) {
        if self.last_attempt.is_some_and(|attempt| attempt.elapsed() < RETRY_INTERVAL) {
            return;
        }
        self.last_attempt = Some(Instant::now());
        if self.attachment.as_ref().is_some_and(|attachment| !attachment.observer.is_running()) {
            self.attachment = None;
            let reason = format!("system {:?} has ended; start it again with `plumb up`", self.system);
            self.state = SourceState::Ended(reason);
            return;
        }
        if self.attachment.is_none() {
            match SystemName::new(&self.system).and_then(|name| Observer::attach(&name, "cockpit")) {
                Ok(observer) => {
                    let missing = observed_topics().chain(self.extra_topic).collect();
                    self.attachment = Some(Attachment { taps: Vec::new(), missing, observer });
                }
                Err(error) => {
                    // A system that has ended remains `Ended` until it runs again.
                    if self.state == SourceState::Live {
                        self.state = SourceState::Connecting(error.to_string());
                    }
                    return;
                }
            }
        }
        if let Some(Attachment { taps, missing, observer }) = &mut self.attachment {
            missing.retain(|topic| match observer.tap(*topic) {
                Ok(tap) => {
                    taps.push((*topic, tap));
                    false
                }
                Err(_) => true,
            });
            taps.sort_by_key(|(topic, _)| Reverse(*topic));
            self.state = SourceState::Live;
        }
    }
}

impl Source for LocalSystem {
    fn poll(&mut self, on_message: &mut dyn FnMut(Topic, &[u8])) -> SourceState {
        self.update_connection();
        let Some(attachment) = &self.attachment else { return self.state.clone() };
        let failed =
            attachment.taps.iter().find_map(|(topic, tap)| tap.drain(&mut |bytes| on_message(*topic, bytes)).err());
        if let Some(error) = failed {
            self.attachment = None;
            self.state = SourceState::Connecting(error.to_string());
        }
        self.state.clone()
    }

    fn has_every_tick(&self) -> bool {
        true
    }

    fn set_readings_topic(&mut self, topic: Option<Topic>) {
        self.extra_topic = topic;
        if let Some(Attachment { taps, missing, .. }) = &mut self.attachment {
            taps.retain(|(tapped, _)| is_observed(*tapped));
            missing.retain(|missing| is_observed(*missing));
            missing.extend(topic);
        }
    }
}

/// Client of a system's supervisor.
#[derive(Debug)]
pub struct SupervisorClient {
    system: String,
    recorder: FlightRecorder,
}

impl SupervisorClient {
    /// Creates the client for the named system.
    pub fn new(system: &str) -> Self {
        Self { system: system.into(), recorder: FlightRecorder::default() }
    }

    fn request<A: serde::de::DeserializeOwned>(&self, request: &ControlRequest) -> Result<A, String> {
        send_request(&self.system, request).map_err(|error| error.to_string())
    }
}

impl CommandTarget for SupervisorClient {
    fn description(&self) -> Result<SystemDescription, String> {
        let ServiceConfig { launch, rate_hz, supervisor_pid, .. } = self.request(&ControlRequest::ServiceConfig)?;
        let slots = Slot::ALL.into_iter().filter(|slot| launch.services.contains(&Service::from(*slot)));
        let slots = slots.map(|slot| SlotDescription {
            slot: slot.name().into(),
            stages: launch.stage_names(slot).into_iter().map(str::to_owned).collect(),
            set: Some(launch.stage(slot).set.clone()),
        });
        Ok(SystemDescription {
            system: launch.name.clone(),
            source: source_label(&launch),
            rate_hz,
            slots: slots.collect(),
            supervisor_pid: Some(supervisor_pid),
        })
    }

    fn services(&self) -> Result<Vec<ServiceStatus>, String> {
        self.request(&ControlRequest::Status)
    }

    fn accepts_commands(&self) -> bool {
        true
    }

    fn swap(&self, request: SwapRequest) -> Result<SwapReport, String> {
        self.request(&ControlRequest::Swap(request))
    }

    fn cancel_shadow(&self, slot: &str) -> Result<(), String> {
        self.request(&ControlRequest::Cancel { slot: slot.into() })
    }

    fn start_recording(&self) -> Result<(), String> {
        let config = self.request(&ControlRequest::ServiceConfig)?;
        self.recorder.start(&config).map_err(|error| error.to_string())
    }

    fn stop_recording(&self) -> Result<(), String> {
        self.recorder.stop().map_err(|error| error.to_string())
    }

    fn recording(&self) -> Option<Recording> {
        self.recorder.progress()
    }

    fn log(&self) -> Result<Vec<String>, String> {
        let config: ServiceConfig = self.request(&ControlRequest::ServiceConfig)?;
        log::last_lines(config.supervisor_pid).map_err(|error| error.to_string())
    }

    fn write_launch_file(&self, sections: &str) -> Result<(), String> {
        let config: ServiceConfig = self.request(&ControlRequest::ServiceConfig)?;
        let file = config.launch_file.ok_or(
            "the system runs with the built-in launch file; copy the section to a new launch.toml and start the system with it",
        )?;
        launch::write_sections(&file, sections).map_err(|error| error.to_string())
    }

    fn calibration_request(&self, kind: Kind) -> Result<CalibrationRequest, String> {
        let config: ServiceConfig = self.request(&ControlRequest::ServiceConfig)?;
        let topic = readings::readings_topic(&config).map_err(|error| error.to_string())?;
        let mut prior = Prior::default();
        readings::apply_system(&mut prior, &config).map_err(|error| error.to_string())?;
        Ok(CalibrationRequest { kind, prior, topic })
    }
}

/// Returns the source of the system's samples for display, such as `sim s1` or `serial
/// /dev/ttyUSB0`.
fn source_label(launch: &Launch) -> String {
    let ingest = &launch.ingest;
    let kind = ingest.source.name();
    match ingest.source {
        LaunchSource::Sim => format!("{kind} {}", ingest.sim.scenario),
        LaunchSource::Replay => {
            let name = ingest.replay.file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into());
            format!("{kind} {name}")
        }
        LaunchSource::Bus | LaunchSource::Stdin => kind.into(),
        LaunchSource::Udp | LaunchSource::Tcp | LaunchSource::Serial | LaunchSource::Mavlink => {
            ingest.port().map_or_else(|| kind.into(), |port| format!("{kind} {port}"))
        }
        LaunchSource::Iio => format!("{kind} {}", ingest.live.iio.device),
    }
}
