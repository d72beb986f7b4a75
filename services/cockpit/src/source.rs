//! Interfaces to a system: a [`Source`] of messages and a [`CommandTarget`] for status and
//! commands.

use std::collections::BTreeMap;

use calibrate::Kind;
use control::{ServiceStatus, SwapReport, SwapRequest};
use graph::Topic;
use wire::v1::{Recording, VehicleLine};

use crate::calibration::CalibrationRequest;

/// State of a source.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SourceState {
    /// The source is not available yet. Contains the reason, which is shown to the user.
    Connecting(String),
    /// Several vehicles are available, but no vehicle is selected yet.
    Unselected,
    /// The source delivers messages.
    Live,
    /// The source has ended. Contains the reason, which is shown to the user.
    Ended(String),
}

/// Source of the messages of a system.
pub trait Source {
    /// Passes each message since the previous poll to `on_message`, in its bus layout. Returns the
    /// state of the source.
    ///
    /// For each slot of the data path, the messages of its output come before those of its inputs.
    fn poll(&mut self, on_message: &mut dyn FnMut(Topic, &[u8])) -> SourceState;

    /// Returns `true` if the source delivers every tick, without decimation.
    fn has_every_tick(&self) -> bool;

    /// Selects an additional topic of sensor readings to deliver; `None` deselects it.
    ///
    /// Called only if [`CommandTarget::calibration_request`] of the same system succeeds.
    fn set_readings_topic(&mut self, _topic: Option<Topic>) {}
}

/// Properties of a system.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SystemDescription {
    /// Name of the system.
    pub system: String,
    /// Source of the system's samples, for display.
    pub source: String,
    /// Declared tick rate, Hz; 0 if unknown.
    pub rate_hz: f64,
    /// Slots that accept commands.
    pub slots: Vec<SlotDescription>,
    /// Process ID of the supervisor; `None` if it runs on another machine.
    pub supervisor_pid: Option<u32>,
}

/// Slot with its stages.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SlotDescription {
    /// Name of the slot.
    pub slot: String,
    /// Names of the available stages.
    pub stages: Vec<String>,
    /// Values of the stage's parameters, except those at their defaults; `None` if unknown.
    pub set: Option<BTreeMap<String, f64>>,
}

/// Status and commands of a system.
///
/// The methods may block, because they are called from threads that may wait. Each error is a
/// reason that can be shown to the user.
pub trait CommandTarget: Send + Sync {
    /// Returns the properties of the system.
    ///
    /// # Errors
    ///
    /// Returns the reason if the system does not respond.
    fn description(&self) -> Result<SystemDescription, String>;

    /// Returns the status of the services.
    ///
    /// # Errors
    ///
    /// Returns the reason if the system does not respond.
    fn services(&self) -> Result<Vec<ServiceStatus>, String>;

    /// Returns the available vehicles if several can be selected, otherwise an empty list.
    fn vehicles(&self) -> Vec<VehicleLine> {
        Vec::new()
    }

    /// Returns `true` if this target accepts commands.
    fn accepts_commands(&self) -> bool;

    /// Swaps the stage of a slot or runs a shadow, and waits for completion.
    ///
    /// # Errors
    ///
    /// Returns the reason if the request cannot be sent or gets no reply.
    fn swap(&self, request: SwapRequest) -> Result<SwapReport, String>;

    /// Cancels the shadow of a slot.
    ///
    /// # Errors
    ///
    /// Returns the reason if the request fails.
    fn cancel_shadow(&self, slot: &str) -> Result<(), String>;

    /// Starts recording the system to a new file.
    ///
    /// # Errors
    ///
    /// Returns the reason if the recording cannot be started.
    fn start_recording(&self) -> Result<(), String> {
        Err("a recording is started on the vehicle; open the vehicle's own page with `plumb view` on board or through `ssh -L`".into())
    }

    /// Stops the recording and waits until its file is complete.
    ///
    /// # Errors
    ///
    /// Returns the reason if there is no recording.
    fn stop_recording(&self) -> Result<(), String> {
        Err("nothing is being recorded".into())
    }

    /// Returns the progress of the recording or the result of the last one; `None` if nothing was
    /// recorded.
    fn recording(&self) -> Option<Recording> {
        None
    }

    /// Returns the last lines that the supervisor and the services have written, oldest first.
    ///
    /// # Errors
    ///
    /// Returns the reason if there is no log.
    fn log(&self) -> Result<Vec<String>, String> {
        Err("the log is on the vehicle; run `plumb logs` there".into())
    }

    /// Writes TOML sections into the launch file of the system.
    ///
    /// # Errors
    ///
    /// Returns the reason if the launch file is unknown or cannot be changed.
    fn write_launch_file(&self, _sections: &str) -> Result<(), String> {
        Err("the launch file is on the vehicle; copy the section to it and restart the system".into())
    }

    /// Returns the request that starts a calibration of the given kind.
    ///
    /// # Errors
    ///
    /// Returns the reason if the sensor readings are not available.
    fn calibration_request(&self, _kind: Kind) -> Result<CalibrationRequest, String> {
        Err("calibration needs every sensor reading; open the vehicle's own page with `plumb view` on board or through `ssh -L`".into())
    }
}
