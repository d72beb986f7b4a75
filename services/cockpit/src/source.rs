//! Where the data come from, and who answers for the system.

use calibrate::Kind;
use control::{ServiceStatus, SwapReport, SwapRequest};
use graph::Topic;
use wire::v1::VehicleLine;

use crate::calibration::CalibrationRequest;

/// How a source is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SourceState {
    /// It is waited for; why, for people.
    Connecting(String),
    /// None is chosen of those in sight.
    Unselected,
    /// Its messages come.
    Live,
    /// It has ended; why, for people.
    Ended(String),
}

/// The messages of a system.
pub trait Source {
    /// Hands over what came since the last look, as it is on the bus: of the path an output before what it was made of.
    fn look(&mut self, take: &mut dyn FnMut(Topic, &[u8])) -> SourceState;

    /// No tick is left out on the way here.
    fn has_every_tick(&self) -> bool;

    /// A topic of the sensors' own readings is to be handed over, too, from now on, or none any more. Nobody asks for it whose
    /// [`CommandTarget::wish`] has none.
    fn set_readings_topic(&mut self, _topic: Option<Topic>) {}
}

/// What a system is.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SystemDescription {
    /// Its name.
    pub system: String,
    /// What it is fed with, for people.
    pub source: String,
    /// Ticks per second as declared; 0 where unknown.
    pub rate_hz: f64,
    /// What each slot can be filled with.
    pub slots: Vec<(String, Vec<String>)>,
    /// The supervisor's process, where it is on this machine.
    pub supervisor_pid: Option<u32>,
}

/// Who answers for a system, and knows who else is in sight; asked from threads that may wait.
pub trait CommandTarget: Send + Sync {
    /// What it is; the reason where nobody answers.
    fn description(&self) -> Result<SystemDescription, String>;

    /// How its services are.
    fn services(&self) -> Result<Vec<ServiceStatus>, String>;

    /// The vehicles in sight, where several can be chosen from.
    fn vehicles(&self) -> Vec<VehicleLine> {
        Vec::new()
    }

    /// Commands can be given here.
    fn takes_commands(&self) -> bool;

    /// Swaps what fills a slot, or runs a shadow; waits until it is done.
    fn swap(&self, request: SwapRequest) -> Result<SwapReport, String>;

    /// Ends a slot's shadow.
    fn cancel_shadow(&self, slot: &str) -> Result<(), String>;

    /// What a calibration goes by; the reason where there can be none.
    fn calibration_request(&self, _kind: Kind) -> Result<CalibrationRequest, String> {
        Err("a calibration needs every reading, which only the vehicle's own page has: `plumb view` on board, or `ssh -L`".into())
    }
}
